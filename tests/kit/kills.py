"""Kill a part of a running capture at some moment, and check everything that must still be true."""

import os
import signal
from collections.abc import Callable
from typing import Any

from tests.kit.wire_cell import WireCell, pause, shipped, wait_for

REST_LIMIT_S = 1.0
AFTER_RESTART_S = 1.5


def short_capture(poses: int, **keys: Any) -> str:
    """A scenario with one placement of so many poses."""
    return shipped("hand_eye", placements=1, poses_per_placement=poses, frames_per_pose=2, **keys)


def kill_the_daemon(cell: WireCell) -> None:
    cell.kill_daemon(signal.SIGKILL)


def stop_the_daemon(cell: WireCell) -> None:
    """A daemon that hangs: its watchdog chain has to stop the arm, then systemd would end it."""
    cell.kill_daemon(signal.SIGSTOP)


def kill_the_arm_child(cell: WireCell) -> None:
    os.kill(cell.child_pid("drivers.ur.motion_child"), signal.SIGKILL)


def kill_the_vision_child(cell: WireCell) -> None:
    os.kill(cell.child_pid("daemon.vision_child"), signal.SIGKILL)


def controller_goes_away(cell: WireCell) -> None:
    cell.inject("arm", "refuse")  # for longer than a run waits


KINDS: dict[str, Callable[[WireCell], None]] = {
    "daemon-killed": kill_the_daemon,
    "daemon-stopped": stop_the_daemon,
    "arm-child-killed": kill_the_arm_child,
    "vision-child-killed": kill_the_vision_child,
    "controller-away": controller_goes_away,
}


def survive(
    cell: WireCell, kind: str, moment_s: float = 0.0, after_poses: int = 0, take_up: bool = True
) -> float:
    """One kill, ``moment_s`` after the arm first moves with so many poses finished; returns the seconds until
    the arm was at rest. ``take_up``: the run is taken up again and goes to its end."""
    wait_for(cell.ready, "all devices", 30.0)
    run_id = cell.start_job("cone-capture")
    wait_for(lambda: len(cell.finished_poses(run_id)) >= after_poses, "poses", 90.0)
    wait_for(cell.moving, "motion", 60.0)
    pause(moment_s)
    before = len(cell.finished_poses(run_id))
    KINDS[kind](cell)
    to_rest = cell.seconds_to_rest(REST_LIMIT_S)
    finished = cell.finished_poses(run_id)
    assert len(finished) >= before, "a finished pose was lost"
    if kind.startswith("daemon"):
        if kind == "daemon-stopped":
            cell.stays_at_rest(0.5)
            cell.kill_daemon(signal.SIGKILL)
        cell.start_daemon()
        status = cell.status()
        assert run_id in status["interrupted"], "the interrupted run was not reported"
    else:
        end = cell.wait_for_end(60.0)
        assert end["outcome"] == "aborted", end
        assert end["error"]["name"] in EXPECTED[kind], end
        if kind == "controller-away":
            cell.inject("arm", "clear")
    cell.stays_at_rest(AFTER_RESTART_S)
    assert [p["index"] for p in cell.finished_poses(run_id)][: len(finished)] == [
        p["index"] for p in finished
    ]
    wait_for(cell.ready, "all devices back", 30.0)
    if cell.status()["latched"]:
        cell.call("reset")
    if not take_up:
        return to_rest
    adopted = cell.call("start", job="cone-capture", adopt=run_id)["run_id"]
    end = cell.wait_for_end(120.0)
    assert end["outcome"] == "complete" or end["error"]["name"] == "SOLVE_REFUSED", end
    taken_up = {p["t"] for p in cell.finished_poses(adopted)}
    assert {p["t"] for p in finished} <= taken_up, "a finished pose was not taken over"
    return to_rest


EXPECTED = {
    "arm-child-killed": {"CHILD_DIED", "ARM_SCRIPT_DIED", "MOTION_WATCHDOG"},
    "vision-child-killed": {"CHILD_DIED", "DEVICE_LOST"},
    "controller-away": {"DEVICE_LOST", "ARM_REBOOTED"},
}
