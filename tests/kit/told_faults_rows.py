"""Faults on virtual time, each with what is wanted of ``check`` and of the job."""

from functools import partial

from tests.kit.told_faults import Row, Wanted, crossing_beams, inject, picking

SLIDER = inject("arm", "speed-slider", fraction=0.5)
REDUCED = inject("arm", "reduced-mode")
ARM_GRIPPER = {"driver": "arm-gripper", "output": 0}
BEAMS = {
    "driver": "modbus-inputs",
    "url": "tcp://192.168.10.30:502",
    "inputs": {"xs": {"address": 0}, "ys": {"address": 1}},
}
STOPS = (
    "[{ speed_m_s = 0.15 }]\nstops = { every_s = [1.0, 3.0], accel_m_s2 = [0.3, 1.2], held_s = [0.2, 1.0] }"
)


def later(more_s: float) -> dict[str, str]:
    """Lines of a world whose arm is so much later on its set-points than its look-ahead."""
    return {"lag": f'"delay"\nmore_s = {more_s}'}


ROWS: tuple[Row, ...] = (
    Row(
        "speed slider at 50 %",
        "before the start",
        Wanted(code="ARM_SPEED_SCALED"),
        partial(picking, before=SLIDER),
    ),
    Row(
        "speed slider at 50 %",
        "with an item",
        Wanted(code="ARM_SPEED_SCALED"),
        partial(picking, following=SLIDER),
    ),
    Row("reduced mode", "before the start", Wanted(code="ARM_NOT_READY"), partial(picking, before=REDUCED)),
    Row("reduced mode", "with an item", Wanted(code="ARM_NOT_READY"), partial(picking, following=REDUCED)),
    Row(
        "autofocus on",
        "camera",
        Wanted(code="CAMERA_LENS_MOVED"),
        partial(picking, world={"width": "1280\nautofocus = true"}),
    ),
    Row(
        "auto exposure, 81 ms",
        "camera",
        Wanted(check="smears an item over 10 mm"),
        partial(
            picking,
            world={"exposure_s": "0.004\nauto_exposure = { light_lux = 100.0 }"},
            sections={"camera": {"driver": "oak"}},
            picks=3,
        ),
        long=True,
    ),
    Row(
        "following error: 0.1 s later than its look-ahead",
        "arm",
        Wanted(warning="belt.following"),  # after the first grip the job has learnt how late the arm is
        partial(picking, world=later(0.1)),
    ),
    Row(
        "following error: 0.5 s later than its look-ahead",
        "arm",
        Wanted(code="ARM_NOT_FOLLOWING"),
        partial(picking, world=later(0.5)),
    ),
    Row("0.02 s later than its look-ahead", "arm", Wanted(), partial(picking, world=later(0.02)), long=True),
    Row("closes in 0.5 s", "gripper", Wanted(), partial(picking, world={"close_s": "0.5"}), long=True),
    Row(
        "closes in 0.5 s, grip_timeout_s 0.4",
        "gripper, job",
        Wanted(check="every grip would count as failed", code="GRIPS_FAILED"),
        partial(
            picking,
            job={"grip_timeout_s": 0.4, "failed_grips": 2},
            world={"close_s": "0.5"},
            sections={"gripper": {**ARM_GRIPPER, "confirm": 7, "moves_s": 0.5}},
        ),
    ),
    Row(
        "closes in 0.5 s, no confirm, moves_s 0.3",
        "gripper, its section",
        Wanted(check="has no confirm", warning="belt.unconfirmed", unconfirmed=True),
        partial(
            picking,
            world={"close_s": "0.5"},
            gripper={"counts_after_s": 0.3},
            sections={"gripper": {**ARM_GRIPPER, "moves_s": 0.3}},
            picks=2,
        ),
    ),
    Row(
        "stamps 3.4 ms late, the belt stops and starts",
        "encoder",
        Wanted(counted=True),
        partial(picking, job={"standing_s": 3.0}, world={"late_s": "0.0034", "profile": STOPS}),
        long=True,
    ),
    Row(
        "stamps 2 ms late",
        "arm",
        Wanted(counted=True),
        partial(picking, world={"force_walk_n": "2.0\nstamp_late_s = 0.002"}),
        long=True,
    ),
    Row(
        "input filter of 100 ms",
        "module of the beams",
        Wanted(check="set a shorter filter in the module", code="LASER_OUT_BACK"),
        partial(crossing_beams, filter_s=0.1, sections={"beams": {**BEAMS, "filter_s": 0.1}}),
        long=True,
    ),
    Row(
        "input filter of 100 ms that nobody told",
        "module of the beams",
        Wanted(check="set the filter of these inputs", code="LASER_OUT_BACK"),
        partial(crossing_beams, filter_s=0.1, sections={"beams": BEAMS}),
    ),
)
