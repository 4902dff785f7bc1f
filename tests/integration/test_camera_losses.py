"""How a camera is lost or not opened: bad sources, children that die or hang, absent servers."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pytest
from camera_chain_scene import Twin, camera, hasty, opened, own, server, shared, subject, twin

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.testing import taken_again
from drivers.oak import OakCamera
from fakes.faults.vocabulary import Fault
from tests.kit.ideal_world import ideal_text

__all__ = ["hasty", "own", "server", "shared", "subject", "twin"]
pytestmark = pytest.mark.wire


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


def test_a_camera_that_never_sends_is_unreachable_in_time_and_what_is_no_longer_looked_for_waits_not_for_it(
    twin: Twin,
) -> None:
    twin.faults.inject(Fault.SILENCE, {})
    subject = camera(twin, open_timeout_s=4.0)

    async def body() -> None:
        start = time.monotonic()
        opening = asyncio.create_task(subject.open())
        await asyncio.sleep(0.5)
        await subject.set_items(None)
        await subject.set_target(None)
        assert not opening.done(), "who ends a run does not wait for a camera that comes back"
        with pytest.raises(CellError) as found:
            await opening
        assert found.value.name == "DEVICE_UNREACHABLE"
        assert time.monotonic() - start < 8.0

    asyncio.run(body())


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


def test_a_lens_that_an_autofocus_moves_is_told_at_the_first_frame_that_shows_it(tmp_path: Path) -> None:
    scenario = tmp_path / "autofocus.toml"
    text = ideal_text("hand_eye").replace("period_s = 0.1\n", "period_s = 0.1\nautofocus = true\n")
    scenario.write_text(text, "utf-8")
    twin = Twin(tmp_path, str(scenario))
    twin.wait()

    async def body() -> None:
        subject = camera(twin)
        try:
            async with asyncio.timeout(15.0):
                with pytest.raises(CellError) as found:
                    await subject.open()
                    raise await subject.wait_lost()
            assert found.value.name == "CAMERA_LENS_MOVED"
        finally:
            await subject.close()

    try:
        asyncio.run(body())
    finally:
        twin.close()
