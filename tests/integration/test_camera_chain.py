"""The whole chain: frame server process, depthai host pipeline in the vision child, driver.

The truth comes from the world itself, projected here by hand.
"""

import asyncio
import itertools
import os
import signal
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from camera_chain_scene import OpenCamera, Twin, hasty, own, server, shared, subject, twin
from numpy.typing import NDArray

from cell.clock import MonotonicClock
from cell.devices import Frame, Intrinsics
from cell.errors import CellError
from drivers.oak import OakCamera
from fakes.faults.vocabulary import Fault
from fakes.world.world import World

__all__ = ["hasty", "own", "server", "shared", "subject", "twin"]
pytestmark = pytest.mark.wire


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
