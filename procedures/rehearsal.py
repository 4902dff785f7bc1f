"""What a job needs of a cell before it can be rehearsed on a twin, and what people do meanwhile."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cell.calibrations import camera_in_delay, time_offset
from cell.errors import CellError, error
from cell.known_cell import (
    KnownBeams,
    KnownBelt,
    KnownCamera,
    KnownDelay,
    KnownGripper,
    KnownLens,
    KnownObserved,
    KnownPictures,
    KnownRack,
    KnownTracker,
)
from procedures.report.numbers import K95
from procedures.setup import Setup

_ARM_SIGNALS = range(18)  # of its digital inputs and outputs
_OF_STEREO = ("depth", "stereo_height", "stereo_subpixel_bits")
_OF_PICTURES = ("width", "height", "fps", "exposure_s", "row_time_s", *_OF_STEREO)


@dataclass(frozen=True)
class Rehearsal:
    """The parts of the cell that the job meets, as its configuration tells them.

    ``look`` is the name of the pose at which the arm stands before the job. ``before`` are jobs that it needs
    the results of; it looks through their camera where it names none, and at their tracker and arm that is
    only read where ``same_arm``. ``moves_board``: the operator
    places the target anew at each prompt; ``bumps_tool``: the tool is hit just before the job; after
    ``items`` the job is finished, 0: it ends by itself. ``held``: how a person brings the tool's point over
    corners of the target, which was moved on before. ``calibrated_camera``: a calibration of the fixed
    camera is in effect before; ``measured_camera``: and its delay was measured, also where the cell has not.
    """

    look: str
    camera: KnownCamera | None = None
    beams: KnownBeams | None = None
    tracker: KnownTracker | None = None
    belt: KnownBelt | None = None
    gripper: KnownGripper | None = None
    rack: KnownRack | None = None
    observed: KnownObserved | None = None
    same_arm: bool = False
    before: tuple[str, ...] = ()
    moves_board: bool = False
    bumps_tool: bool = False
    items: int = 0
    calibrated_camera: bool = False
    measured_camera: bool = False
    held: "HeldPoint | None" = None


@dataclass(frozen=True)
class HeldPoint:
    """A person brings the tool's point over the corner that the job publishes: with a gauge of ``gauge_m``
    between, and ``hand_m`` (one standard deviation of an axis) beside it. The ``target`` lies where the
    camera on the flange sees it at joints ``q``; the job before has brought camera and target."""

    gauge_m: float
    hand_m: float
    target: Mapping[str, Any]
    q: Sequence[float]


def joints(setup: Setup, name: str | None) -> tuple[str, list[float]]:
    """Name and joints (6,) rad of a pose in ``[poses]``, of ``home`` without a name; ``CONFIG_INVALID``."""
    name = name or "home"
    if name not in setup.poses:
        raise cannot(f"[poses] has no '{name}', from which the twin's arm would start; teach it")
    return name, list(setup.poses[name])


def nominal(setup: Setup, key: str) -> list[float]:
    """A nominal pose (6,) of ``[robot]``; ``CONFIG_INVALID`` without it."""
    pose = setup.nominal[key]
    if pose is None:
        raise cannot(f"[robot] has no {key}, around which the twin's own would be drawn; give it")
    return list(pose)


def needed(setup: Setup, *roles: str) -> None:
    """``CONFIG_INVALID`` with one sentence for each role that no device plays."""
    if missing := setup.missing(*roles):
        raise cannot("; ".join(missing))


def target(setup: Setup, name: str) -> tuple[Mapping[str, Any], dict[str, float]]:
    """A target of ``[target]``, and how well its size and flatness are known as far as it says so."""
    if name not in setup.values.targets:
        raise cannot(f"there is no [target.{name}]; the job names it")
    section = dict(setup.values.targets[name])
    stated = {key: float(section[key]) for key in ("scale_sigma", "flatness_m") if section.get(key)}
    return section, stated


def gripper(setup: Setup, place_clear: str | None = None) -> KnownGripper:
    """The cell's own; in a twin it is on inputs and outputs of the arm, whatever it is on here."""
    section = setup.devices[setup.roles["gripper"]]
    output, confirm = int(getattr(section, "output", 0)), getattr(section, "confirm", None)
    if not (output in _ARM_SIGNALS and (confirm is None or confirm in _ARM_SIGNALS)):  # of another device
        output, confirm = 0, None
    return KnownGripper(output, confirm, place_clear, getattr(section, "moves_s", None))


def pictures(setup: Setup, role: str) -> KnownPictures:
    """What the section of the camera with this role asks of it, the lens that the hand-eye in effect found
    for such pictures, and the delay in effect."""
    section = setup.devices.get(setup.roles.get(role, ""))
    asked = {key: getattr(section, key) for key in _OF_PICTURES if hasattr(section, key)}
    made = KnownPictures(**asked, delay=measured_delay(setup, role))
    found = _stated(setup, "T_flange_camera" if role == "flange_camera" else "T_base_camera").get("lens")
    if found is None or (found["width"], found["height"]) != (made.width, made.height):
        return made
    return replace(made, lens=KnownLens(found["K"], found["dist"]))


def measured_delay(setup: Setup, role: str) -> KnownDelay | None:
    """Of the stamps of the device with this role, by the version in effect."""
    if (device := setup.roles.get(role)) is None:
        return None
    name = time_offset(device)
    stated = _stated(setup, name)
    interval = stated.get("interval95_s")
    if interval is None:
        return None
    low, high = interval
    delay = KnownDelay(0.5 * (low + high), 0.5 * (high - low) / K95, name)
    if role != "belt" or "fixed_camera" not in setup.roles:
        return delay
    camera = time_offset(setup.roles["fixed_camera"])
    version = (setup.committed(camera) or {}).get("version")
    return replace(delay, camera=camera, camera_sigma_s=camera_in_delay(stated, camera, version))


def _stated(setup: Setup, name: str) -> Mapping[str, Any]:
    """As of ``Setup.stated``; nothing where the ledger cannot be read, as by who may rehearse and no more."""
    try:
        return setup.stated(name)
    except CellError as exc:
        if exc.name != "ACCESS_DENIED":
            raise
        return {}


def cannot(why: str) -> CellError:
    """The job cannot be rehearsed with this configuration."""
    return error("CONFIG_INVALID", why)
