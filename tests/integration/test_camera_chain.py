"""The whole chain: frame server process, depthai host pipeline in the vision child, driver.

The truth comes from the world itself, projected here by hand.
"""

import asyncio
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from cell.clock import MonotonicClock
from cell.devices import Frame, Intrinsics
from cell.errors import CellError
from cell.testing import taken_again
from drivers.oak import OakCamera
from fakes.faults.vocabulary import Fault
from fakes.frames.faults import CameraFaults
from fakes.frames.server import serve_frames
from fakes.world.scenario import Scenario
from fakes.world.world import Message, World

pytestmark = pytest.mark.wire


class Twin:
    """The frame server's process and the world that it mirrors."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "frames.sock"
        self.world = World.from_scenario(Scenario.load("hand_eye"), time.monotonic())
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=serve_frames, args=(str(self.path), "hand_eye", theirs), daemon=True
        )
        self.process.start()
        theirs.close()
        self.world.mirror_to(self._send)
        self.faults = CameraFaults(self._send)

    def _send(self, message: Message) -> None:
        self._pipe.send([message])  # several may go together

    def wait(self) -> None:
        deadline = time.monotonic() + 120.0
        while not self.path.exists():
            assert self.process.is_alive()
            assert time.monotonic() < deadline
            time.sleep(0.05)

    def close(self) -> None:
        self._pipe.close()
        self.process.join(5.0)
        assert not self.process.is_alive(), "the server ends with its pipe"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    twin = Twin(tmp_path_factory.mktemp("twin"))
    twin.wait()
    yield twin
    twin.close()


@pytest.fixture
def twin(server: Twin) -> Iterator[Twin]:
    yield server
    server.faults.clear()


class OpenCamera:
    """A camera that is open, with its target chosen, and a loop for it: its child takes seconds to start."""

    def __init__(self, twin: Twin) -> None:
        self._runner = asyncio.Runner()
        # More than the usual patience: the machine that runs the tests may pause.
        self.camera = camera(twin, frame_timeout_s=8.0)

    def run(self, test: Callable[[], Awaitable[None]]) -> None:
        async def body() -> None:
            try:
                await self.camera.wait_fresh(10.0)
            except CellError:  # not open yet, or lost by what a test did to the server
                await open_with_target(self.camera)
            async with asyncio.timeout(60.0):
                await test()

        taken_again.play(body, self._runner.run)

    def close(self) -> None:
        self._runner.run(self.camera.close())
        self._runner.close()


@pytest.fixture(scope="module")
def shared(server: Twin) -> Iterator[OpenCamera]:
    """For tests that leave the camera as it was."""
    opened_once = OpenCamera(server)
    opened_once.run(opened_once.camera.identify)  # its child is not one of the first test's
    yield opened_once
    opened_once.close()


@pytest.fixture
def subject(shared: OpenCamera, twin: Twin) -> OakCamera:
    return shared.camera


@pytest.fixture
def own(twin: Twin) -> OakCamera:
    """For a test that spoils it."""
    return camera(twin, frame_timeout_s=8.0)


@pytest.fixture
def hasty(twin: Twin) -> OakCamera:
    """For losses by silence."""
    return camera(twin, frame_timeout_s=2.0)


def camera(twin: Twin, **config: Any) -> OakCamera:
    source = f"frames+unix://{twin.path}"
    return OakCamera("camera", OakCamera.Config(source=source, **config), MonotonicClock())


async def open_with_target(camera: OakCamera) -> None:
    await camera.close()
    await camera.set_target(Scenario.load("hand_eye").world.target)
    await camera.open()


def opened(subject: OakCamera, test: Callable[[], Awaitable[None]]) -> None:
    """Run ``test`` with the camera open and its target chosen; again where a pause interrupted it."""

    async def body() -> None:
        await open_with_target(subject)
        try:
            async with asyncio.timeout(60.0):
                await test()
        finally:
            await subject.close()

    taken_again.play(body)


def project(camera: Intrinsics, points: NDArray[Any]) -> NDArray[Any]:
    """Pinhole and Brown-Conrady by hand; (n, 3) in the camera to (n, 2) pixels."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3 = camera.dist
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fx, fy, cx, cy = camera.K
    return np.column_stack([fx * xd + cx, fy * yd + cy])


def corner_error(frame: Frame, world: World) -> NDArray[Any]:
    """Found corners minus the world's truth at the frame's exposure, pixels (n, 2)."""
    assert frame.board is not None
    pose = world.scene(frame.t_exposure).T_camera_target
    assert pose is not None
    k = frame.board.ids
    points = np.column_stack([k % 9 + 1, k // 9 + 1, np.zeros(len(k))]) * 0.025
    return frame.board.corners - project(world.intrinsics, pose.apply(points))


def test_a_still_board_is_seen_where_it_truly_is(subject: OakCamera, shared: OpenCamera, twin: Twin) -> None:
    async def body() -> None:
        identity = await subject.identify()
        assert identity.is_twin
        assert identity.serial == twin.world.config.camera.serial
        for _ in range(3):
            await subject.wait_fresh(10.0)
        frame = subject.frames.latest(8.0).value
        assert pytest.approx(twin.world.intrinsics.K, rel=1e-6) == frame.intrinsics.K
        assert frame.intrinsics.dist == pytest.approx(twin.world.intrinsics.dist, abs=1e-7)
        assert frame.exposure_s == pytest.approx(0.008)
        error = corner_error(frame, twin.world)
        assert len(error) == 54
        assert np.abs(error.mean(axis=0)).max() < 0.03
        assert np.sqrt(np.mean(error**2)) < 0.1

    shared.run(body)


def test_a_board_in_motion_is_seen_where_it_was_at_mid_exposure(
    subject: OakCamera, shared: OpenCamera, twin: Twin
) -> None:
    async def body() -> None:
        frames: list[Frame] = []
        unsubscribe = subject.frames.subscribe(lambda sample: frames.append(sample.value))
        start = time.monotonic()
        q = twin.world.track.at(start)[0]
        end = twin.world.track.start_joint_move(
            start, q + np.array([0.06, 0.0, 0.0, 0.0, 0.0, 0.05]), v=0.08, a=0.5
        )
        await asyncio.sleep(end - start)
        back = twin.world.track.start_joint_move(time.monotonic(), q, v=0.5, a=2.0)
        await asyncio.sleep(back - time.monotonic() + 0.2)
        unsubscribe()
        moving = [f for f in frames if start + 0.1 < f.t_exposure < end - 0.1 and f.board is not None]
        assert len(moving) >= 2
        speeds = [np.abs(twin.world.track.at(f.t_exposure)[1]).max() for f in moving]
        assert min(speeds) > 0.01, "the arm moved at every one of these exposures"
        # At this speed the image moves by about 0.1 px in a millisecond.
        bias = np.median([np.abs(corner_error(f, twin.world).mean(axis=0)).max() for f in moving])
        assert bias < 0.15

    shared.run(body)


def test_captured_files_hold_the_exposures_after_the_given_time(
    subject: OakCamera, shared: OpenCamera, twin: Twin, tmp_path: Path
) -> None:
    async def body() -> None:
        after = time.monotonic() + 0.15
        frames = await subject.capture(3, tmp_path, "pose-007", after)
        assert [f.t_exposure - f.exposure_s / 2 >= after for f in frames] == [True] * 3
        assert [b.seq > a.seq for a, b in itertools.pairwise(frames)] == [True] * 2
        names = {f"pose-007-{k}{kind}.png" for k in range(3) for kind in ("", "-depth")}
        assert set(os.listdir(tmp_path)) == names, "no temporary file is left"
        for k, frame in enumerate(frames):
            assert frame.colour_file == tmp_path / f"pose-007-{k}.png"
            colour = cv2.imread(str(frame.colour_file), cv2.IMREAD_UNCHANGED)
            depth = cv2.imread(str(frame.depth_file), cv2.IMREAD_UNCHANGED)
            assert (colour.shape, colour.dtype) == ((800, 1280, 3), np.uint8)
            assert (depth.shape, depth.dtype) == ((800, 1280), np.uint16)
            pose = twin.world.scene(frame.t_exposure).T_camera_target
            assert pose is not None
            middle = pose.apply([[0.125, 0.0875, 0.0]])
            u, v = np.rint(project(twin.world.intrinsics, middle)).astype(int)[0]
            patch = depth[v - 5 : v + 6, u - 5 : u + 6]
            assert abs(float(patch.mean()) - 1000.0 * middle[0, 2]) < 2.0

    shared.run(body)


def test_files_that_cannot_be_written_are_a_coded_error(
    subject: OakCamera, shared: OpenCamera, tmp_path: Path
) -> None:
    async def body() -> None:
        with pytest.raises(CellError) as caught:
            await subject.capture(1, tmp_path / "missing", "a", 0.0)
        assert caught.value.name == "DISK_FAILED"
        await subject.wait_fresh(10.0)

    shared.run(body)


def test_a_target_that_makes_no_sense_is_refused_and_the_old_one_kept(
    subject: OakCamera, shared: OpenCamera
) -> None:
    async def body() -> None:
        with pytest.raises(CellError):
            await subject.set_target({"type": "charuco", "squares_x": 1})
        await subject.wait_fresh(10.0)
        assert subject.frames.latest(8.0).value.board is not None
        await subject.set_target(None)
        await subject.wait_fresh(10.0)
        await subject.wait_fresh(10.0)
        assert subject.frames.latest(8.0).value.board is None

    shared.run(body)


def test_a_board_that_leaves_the_view_is_no_longer_reported(
    subject: OakCamera, shared: OpenCamera, twin: Twin
) -> None:
    async def body() -> None:
        twin.faults.inject(Fault.LOST_BOARD, {})
        await asyncio.sleep(0.3)
        await subject.wait_fresh(10.0)
        assert subject.frames.latest(8.0).value.board is None

    shared.run(body)


def test_a_loop_that_was_busy_gets_new_frames_not_a_queue_of_old_ones(
    subject: OakCamera, shared: OpenCamera
) -> None:
    async def body() -> None:
        await subject.wait_fresh(10.0)
        pid = subject.health()["child_pid"]
        before = subject.frames.latest(8.0)
        os.kill(pid, signal.SIGSTOP)
        await asyncio.sleep(0.6)
        os.kill(pid, signal.SIGCONT)
        await subject.wait_fresh(10.0)
        after = subject.frames.latest(8.0)
        assert after.seq - before.seq > 3
        assert subject.frames.gaps > 0, "what the child did not read was lost, and it shows"

    shared.run(body)


@pytest.mark.parametrize("offset_s", [0.02, 0.3, -0.3])
def test_the_configured_offset_is_subtracted_from_the_stamp_of_the_same_exposure(
    offset_s: float, subject: OakCamera, shared: OpenCamera, twin: Twin
) -> None:
    config = OakCamera.Config(source=f"frames+unix://{twin.path}", time_offset_s=offset_s)
    shifted = OakCamera("shifted", config, MonotonicClock())

    async def body() -> None:
        await shifted.open()
        try:
            await asyncio.sleep(0.8)
            now = time.monotonic()
            plain = {s.seq: s.t for s in subject.frames.between(0.0, now)}
            moved = {s.seq: s.t for s in shifted.frames.between(0.0, now)}
        finally:
            await shifted.close()
        both = plain.keys() & moved.keys()
        assert both, "two readers see the same exposures"
        assert [moved[k] - plain[k] for k in both] == pytest.approx([-offset_s] * len(both), abs=2e-6)

    shared.run(body)


# -- what spoils the camera or the server comes last

BAD_SOURCES: list[tuple[Fault, dict[str, Any], str]] = [
    (Fault.SILENCE, {}, "DEVICE_LOST"),
    (Fault.FREEZE, {}, "DEVICE_LOST"),
    (Fault.DELAY, {"delay_s": 3.0}, "DEVICE_LOST"),
    (Fault.DROP, {}, "DEVICE_LOST"),
    (Fault.JUNK, {}, "PROTOCOL_VIOLATION"),
    (Fault.CLOCK_JUMP, {"jump_s": 100.0}, "PROTOCOL_VIOLATION"),
]


def test_every_bad_source_is_a_loss_with_its_own_name_and_can_be_opened_again(
    hasty: OakCamera, twin: Twin
) -> None:
    subject = hasty

    async def body() -> None:
        for fault, arguments, name in BAD_SOURCES:
            await subject.wait_fresh(10.0)
            twin.faults.inject(fault, arguments)
            async with asyncio.timeout(15.0):
                lost = await subject.wait_lost()
            assert isinstance(lost, CellError)
            taken_again.interrupted(lost.name, {name})
            assert (fault, lost.name) == (fault, name), lost
            with pytest.raises(CellError):
                await subject.identify()
            twin.faults.clear()
            await subject.open()
        await subject.wait_fresh(10.0)

    opened(subject, body)


def test_a_camera_that_comes_back_as_another_one_says_so(own: OakCamera, twin: Twin) -> None:
    subject = own

    serial = twin.world.config.camera.serial

    async def body() -> None:
        twin.faults.inject(Fault.REBOOT, {"serial": "99992200777"})
        async with asyncio.timeout(15.0):
            await subject.wait_lost()
        await subject.open()
        assert (await subject.identify()).serial == "99992200777"
        twin.faults.inject(Fault.REBOOT, {"serial": serial})

    opened(subject, body)


def test_a_killed_child_is_a_device_that_dropped_and_a_new_open_works(own: OakCamera) -> None:
    subject = own

    async def body() -> None:
        capture = asyncio.create_task(subject.capture(1, Path("/nowhere"), "a", time.monotonic() + 60.0))
        await subject.wait_fresh(10.0)
        os.kill(subject.health()["child_pid"], signal.SIGKILL)
        async with asyncio.timeout(15.0):
            lost = await subject.wait_lost()
            with pytest.raises(CellError) as caught:
                await capture
        assert isinstance(lost, CellError)
        assert (lost.name, caught.value.name) == ("CHILD_DIED", "CHILD_DIED")
        assert "SIGKILL" in lost.detail
        epoch = subject.frames.epoch
        await subject.open()
        await subject.wait_fresh(10.0)
        assert subject.frames.epoch == epoch + 1
        assert subject.frames.latest(8.0).value.board is not None, "the target outlives the child"

    opened(subject, body)


def test_the_child_has_a_session_and_so_a_share_of_busy_cores_of_its_own(own: OakCamera) -> None:
    subject = own

    async def body() -> None:
        pid = subject.health()["child_pid"]
        assert os.getsid(pid) == pid

    opened(subject, body)


def test_a_hung_child_is_a_loss_and_closing_ends_it(hasty: OakCamera) -> None:
    subject = hasty

    async def body() -> None:
        pid = subject.health()["child_pid"]
        os.kill(pid, signal.SIGSTOP)
        async with asyncio.timeout(15.0):
            lost = await subject.wait_lost()
        assert isinstance(lost, CellError)
        assert lost.name == "DEVICE_LOST"
        async with asyncio.timeout(15.0):
            await subject.close()
        assert not psutil.pid_exists(pid)

    opened(subject, body)


@pytest.mark.parametrize("closed_first", [False, True], ids=["never opened", "closed"])
def test_a_camera_that_is_not_open_says_so(own: OakCamera, closed_first: bool) -> None:
    subject = own

    async def body() -> None:
        if closed_first:
            await subject.open()
            await subject.close()
        for call in (subject.identify(), subject.wait_fresh(0.1), subject.capture(1, Path("/"), "a", 0.0)):
            with pytest.raises(CellError) as caught:
                await call
            assert caught.value.name == "DEVICE_LOST"
        assert isinstance(await subject.wait_lost(), CellError)

    asyncio.run(body())


def unopenable(**config: Any) -> CellError:
    camera = OakCamera("camera", OakCamera.Config(**config), MonotonicClock())

    async def body() -> CellError:
        with pytest.raises(CellError) as caught:
            await camera.open()
        return caught.value

    return asyncio.run(body())


def test_a_missing_frame_server_is_unreachable(tmp_path: Path) -> None:
    found = unopenable(source=f"frames+unix://{tmp_path}/none.sock")
    assert found.name == "DEVICE_UNREACHABLE"
    assert "none.sock" in found.detail


def test_a_camera_that_never_sends_is_unreachable_in_time(twin: Twin) -> None:
    twin.faults.inject(Fault.SILENCE, {})
    start = time.monotonic()
    found = unopenable(source=f"frames+unix://{twin.path}", open_timeout_s=4.0)
    assert found.name == "DEVICE_UNREACHABLE"
    assert time.monotonic() - start < 8.0


def test_an_absent_oak_is_unreachable_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DEPTHAI_SEARCH_TIMEOUT", "500")
    start = time.monotonic()
    found = unopenable(source="oak")
    assert found.name == "DEVICE_UNREACHABLE"
    assert time.monotonic() - start < 17.0


def test_a_child_that_cannot_start_is_a_dead_child(twin: Twin) -> None:
    config = OakCamera.Config(source=f"frames+unix://{twin.path}")
    camera = OakCamera("camera", config, MonotonicClock(), child_module="no_such_module")

    async def body() -> None:
        with pytest.raises(CellError) as caught:
            await camera.open()
        assert caught.value.name == "CHILD_DIED"
        assert "no_such_module" in caught.value.detail

    asyncio.run(body())


DAEMON = """
import asyncio, sys
from cell.clock import MonotonicClock
from drivers.oak import OakCamera

async def main():
    camera = OakCamera("camera", OakCamera.Config(source=sys.argv[1]), MonotonicClock())
    await camera.open()
    print(camera.health()["child_pid"], flush=True)
    await asyncio.sleep(60.0)

asyncio.run(main())
"""


def test_the_child_dies_with_a_killed_daemon(twin: Twin) -> None:
    daemon = subprocess.Popen(
        [sys.executable, "-c", DAEMON, f"frames+unix://{twin.path}"], stdout=subprocess.PIPE, text=True
    )
    assert daemon.stdout is not None
    child = psutil.Process(int(daemon.stdout.readline()))
    assert "daemon.vision_child" in child.cmdline()
    daemon.kill()
    daemon.wait(5.0)
    daemon.stdout.close()
    gone, alive = psutil.wait_procs([child], timeout=5.0)
    assert not alive
    assert gone
