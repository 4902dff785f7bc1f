"""What the demo shows: which runs each of its jobs takes, and what happens to the twin around them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from cell.known_cell import KnownDelay
from daemon.demo import plc
from procedures.rehearsal import HeldPoint


@dataclass(frozen=True)
class Bump:
    """The tool is hit: its point is shifted, and its axis tilted about x and y, both in the flange frame."""

    shift_m: tuple[float, float, float]
    tilt_rad: tuple[float, float]


@dataclass(frozen=True)
class Step:
    """One run: what must be ready, how long it takes on real protocols, and what is done to the twin before.

    ``moves_board`` says what a prompt asks of the operator: to place the board anew, else only to confirm.
    Steps with another ``twin`` run in a twin of their own (``daemon.demo.scenes``). Those that are
    ``objects`` run as in the fast demo, beside the others.
    """

    job: str
    number: int
    needs: int
    seconds: int
    text: str
    moves_board: bool = False
    bump: Bump | None = None
    twin: str = "bay"
    picks: int = 0  # after so many the PLC finishes the job
    after: str | None = None  # the job whose result it needs
    held: HeldPoint | None = None  # a person brings the tool's point over corners of the board
    part_in_hand: bool = False  # a person puts a part into the gripper before
    removes_board: bool = False  # the board is taken away before
    objects: bool = False
    given_camera: bool = False  # the twin's own T_base_camera stands for an earlier calibration
    given_delay: bool = False  # how late the twin's fixed camera is counts as measured before
    delays: Mapping[str, KnownDelay] = field(default_factory=dict)  # by device: as the cell has measured them
    params: Mapping[str, Any] = field(default_factory=dict)  # of this run, beside its section of the config
    finds_fault: bool = False  # the twin has a fault that it has to find: its verdict should be "fail"
    over_can: bool = False  # the PLC starts it over the encoder's CAN bus, not over Modbus
    compares: bool = False  # no run: the runs of its twin before it are judged against each other


CONE_CAPTURE = Step(
    "cone-capture",
    1,
    plc.ARM_OK | plc.CAMERA_OK,
    85,
    "3 placements of the board, 10 arm poses each, with the errors of an ordinary arm, lens and print",
    moves_board=True,
    twin="workshop",
)
LASER_REFERENCE = Step(
    "laser-reference",
    2,
    plc.ARM_OK | plc.BEAMS_OK,
    65,
    "the good tool through both beams, at two places each",
)
LASER_UPDATE = Step(
    "laser-update",
    4,
    plc.ARM_OK | plc.BEAMS_OK,
    80,
    "the tool is bumped, measured, corrected, and measured again",
    bump=Bump((0.0012, -0.0007, 0.0005), (0.008, -0.006)),
    after="laser-reference",
)
TRACKER_SAMPLING = Step(
    "tracker-sampling",
    5,
    plc.ARM_OK | plc.TRACKER_OK,
    60,
    "15 poses seen by a laser tracker, solved together with a stored set",
    twin="tracker",
)
BELT_CALIBRATION = Step(
    "belt-calibration",
    6,
    plc.CAMERA_OK | plc.ENCODER_OK,
    25,
    "a belt calibrated by the items that it carries",
    twin="picking",
    given_camera=True,
)
BELT_TRACKING = Step(
    "belt-tracking",
    7,
    plc.ARM_OK | plc.CAMERA_OK | plc.ENCODER_OK,
    45,
    "10 items picked from a moving belt, started over CAN",
    twin="picking",
    over_can=True,
    picks=10,
    given_camera=True,
)
EYE_TO_HAND = replace(
    CONE_CAPTURE, text="a fixed camera and a board on the flange", twin="eye_to_hand", objects=True
)
EYE_TO_HAND_CHECK = Step(
    "eye-to-hand-check",
    8,
    plc.ARM_OK | plc.CAMERA_OK,
    0,
    "that camera's pose and the arm's positioning graded, and targets driven to and seen again",
    twin="eye_to_hand",
    objects=True,
)
RACK = replace(CONE_CAPTURE, text="the camera of the arm before the rack", twin="rack", objects=True)
SLOT_INSERTION = Step(
    "slot-insertion",
    9,
    plc.ARM_OK | plc.CAMERA_OK,
    0,
    "a part into a slot with 0.5 mm of room",
    twin="rack",
    removes_board=True,
    objects=True,
)
CAMERA_DELAY = Step(
    "latency-calibration",
    10,
    plc.ARM_OK | plc.CAMERA_OK,
    0,
    "a camera that stamps 15 ms late",
    twin="delays",
    objects=True,
    given_camera=True,
)
ENCODER_DELAY = replace(
    CAMERA_DELAY,
    text="an encoder that is 8 ms late",
    params={"source": "belt", "belt_z_m": 0.15},
)
OBSERVED_ARM = Step(
    "tracker-sampling",
    5,
    plc.TRACKER_OK,
    0,
    "a palletizer that its own program moves",
    twin="targets",
    objects=True,
)
CORRECTED_TARGETS = Step(
    "corrected-targets",
    13,
    plc.TRACKER_OK,
    0,
    "its targets as given and corrected",
    twin="targets",
    objects=True,
)
THEN = replace(CONE_CAPTURE, text="a cell when all is well", twin="changed", objects=True)
GOOD_TOOL = replace(LASER_REFERENCE, twin="changed", objects=True)
BENT_TOOL = Step(
    "laser-check",
    3,
    plc.ARM_OK | plc.BEAMS_OK,
    0,
    "its tool is bent and found in the beams",
    bump=Bump((0.0009, -0.0012, 0.0), (0.0, 0.0)),
    twin="changed",
    objects=True,
    finds_fault=True,
)
NOW = replace(THEN, text="a capture of now", params={"accept": {"auto": False}})
TOUCH_TEST = Step(
    "touch-test",
    14,
    plc.ARM_OK | plc.CAMERA_OK,
    0,
    "the tool's point over four corners of the board",
    twin="changed",
    held=HeldPoint(0.003, 0.0002, {}, ()),
    objects=True,
    finds_fault=True,
)
CROSS_CHECK = Step(
    "cross-check",
    0,
    0,
    0,
    "captures, beams and touched corners name the part that has changed",
    twin="changed",
    objects=True,
    compares=True,
)
# In the order in which they are shown; steps of one twin stand together.
STEPS: dict[str, tuple[Step, ...]] = {
    "cone-capture": (CONE_CAPTURE,),
    "laser-update": (LASER_REFERENCE, LASER_UPDATE),
    "tracker-sampling": (TRACKER_SAMPLING,),
    "belt-tracking": (BELT_CALIBRATION, BELT_TRACKING),
    "eye-to-hand-check": (EYE_TO_HAND, EYE_TO_HAND_CHECK),
    "slot-insertion": (RACK, SLOT_INSERTION),
    "latency-calibration": (CAMERA_DELAY, ENCODER_DELAY),
    "corrected-targets": (OBSERVED_ARM, CORRECTED_TARGETS),
    "cross-check": (THEN, GOOD_TOOL, BENT_TOOL, NOW, TOUCH_TEST, CROSS_CHECK),
}


def shown_with(job: str) -> str | None:
    """The entry of ``STEPS`` in which ``job`` is shown: its own, else the first of those it is run for."""
    if job in STEPS:
        return job
    return next((name for name, steps in STEPS.items() if any(s.job == job for s in steps)), None)


def steps_of(jobs: Sequence[str]) -> list[Step]:
    """The runs of these jobs of the demo, in the demo's own order; without any, of all."""
    wanted = {shown_with(job) for job in jobs or STEPS}
    return [step for name, steps in STEPS.items() if name in wanted for step in steps]


def eta_text(steps: Sequence[Step]) -> str:
    """How long it takes and what is to be seen, in one sentence."""
    real = [step for step in steps if not step.objects]
    minutes = max(round(sum(step.seconds for step in real) / 60), 1)
    shown = "; ".join(step.text for step in real or steps)  # those on objects are named by themselves
    return f"about {minutes} minute{'s' * (minutes > 1)} in real time: {shown}"
