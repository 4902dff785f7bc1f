"""A touch test on a twin, behind the capture of the hand-eye, with a person at the corners."""

from procedures.rehearsal import HeldPoint, Rehearsal, joints, needed, target
from procedures.setup import Setup
from procedures.touch_test.config import TouchTestConfig

CAPTURE = "cone-capture"


def rehearse_touch(setup: Setup, job: TouchTestConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    needed(setup, "arm", "flange_camera")
    look, q = joints(setup, job.look_pose)
    board, _ = target(setup, job.target)
    held = HeldPoint(job.stand_off_m, job.stand_sigma_m, board, q)
    return Rehearsal(look, before=(CAPTURE,), held=held)
