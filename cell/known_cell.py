"""What a configuration tells of a cell's world: as much as a twin needs to stand in for it.

Nominal values only. Lengths are metres, angles radians; a pose is (6,), translation and rotation vector, in
the frames that its name says. A part that a job does not need is None.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Pose = Sequence[float]


@dataclass(frozen=True)
class KnownLens:
    """``K`` = fx, fy, cx, cy in pixels, and ``dist`` in OpenCV's order."""

    K: Sequence[float]
    dist: Sequence[float]


@dataclass(frozen=True)
class KnownDelay:
    """How late the stamps of a device are against the arm's, as the cell has measured it: ``late_s``, with
    the standard deviation ``sigma_s``; ``name`` is that of its calibration.

    ``camera_sigma_s``: the part of an encoder's ``sigma_s`` that is the error of the delay in effect of its
    camera, as of ``camera_in_delay``; ``camera`` is the name of that calibration.
    """

    late_s: float
    sigma_s: float
    name: str = ""
    camera: str = ""
    camera_sigma_s: float | None = None


@dataclass(frozen=True)
class KnownPictures:
    """What a camera's section asks of it: ``width`` and ``height`` in pixels, ``fps`` pictures a second.

    ``exposure_s``: fixed, None: automatic. ``row_time_s``: from row to row, None: by the sensor. ``depth``:
    with a stereo pair, whose pictures are ``stereo_height`` pixels high and matched to
    2 ** ``stereo_subpixel_bits`` steps of a pixel. ``lens``: as a calibration of pictures of this size found
    it, None: none has. ``delay``: of its stamps, None: nobody measured it.
    """

    width: int = 1280
    height: int = 800
    fps: float = 10.0
    exposure_s: float | None = 0.008
    row_time_s: float | None = None
    depth: bool = True
    stereo_height: int = 400
    stereo_subpixel_bits: int | None = None  # three, as the device has them by itself
    lens: KnownLens | None = None
    delay: KnownDelay | None = None


@dataclass(frozen=True)
class KnownCamera:
    """A camera, and the target that it is calibrated with.

    ``T_mount_camera``: nominal, in the flange, or in the base when it is ``fixed``; ``T_flange_target``: the
    same of a target on the flange. ``looks``: joints where the camera sees the target, ``distance_m`` away,
    for each of its placements. ``target_sigma_t_m``, ``target_sigma_r_rad``: how well ``T_flange_target`` is
    known along and about an axis of the flange; None where it is only drawn.
    ``scale_sigma``: share by which the target's size is unknown; ``flatness_m``: how far it may bend.
    """

    fixed: bool
    T_mount_camera: Pose
    target: Mapping[str, Any]
    looks: Sequence[Sequence[float]]
    distance_m: float
    T_flange_target: Pose | None = None
    target_sigma_t_m: float | None = None
    target_sigma_r_rad: float | None = None
    scale_sigma: float = 0.002
    flatness_m: float = 0.0002
    pictures: KnownPictures = KnownPictures()


@dataclass(frozen=True)
class KnownBeam:
    """A light beam: at joints ``q_aux`` the tool's point is beside it and above it.

    ``across`` is the level unit direction of the way through it in the base, ``distance_m`` long;
    ``along_m`` is how far to its left it is crossed a second time.
    """

    channel: int
    q_aux: Sequence[float]
    across: Sequence[float]
    distance_m: float
    along_m: float


@dataclass(frozen=True)
class KnownBeams:
    """Crossed beams by the name of their input; the search goes down by ``reach_m`` at most.

    ``filter_s`` is that of the module that reads them, None where no section tells it; with ``counters`` it
    counts edges, and they are read.
    """

    beams: Mapping[str, KnownBeam]
    pin_radius_m: float
    reach_m: float
    filter_s: float | None = None
    counters: bool = False


@dataclass(frozen=True)
class KnownObserved:
    """An arm that its own program moves, or a person where ``by_person``; it goes to what it is asked for.

    ``robot`` is what its controller believes, a ROBOT as docs/data-sets.md has it. ``ranges`` (j, 2) rad are
    those of its joints that a job makes use of.
    """

    robot: Mapping[str, Any]
    ranges: Sequence[Sequence[float]]
    by_person: bool


@dataclass(frozen=True)
class KnownReflector:
    """A reflector's centre in the flange, or in the base when it is a monument, and the way it looks; the
    flange is that of the arm that is only read when it is on it (``observed``)."""

    point: Sequence[float]
    monument: bool = False
    observed: bool = False
    normal: Sequence[float] | None = None
    half_angle_rad: float = 0.52


@dataclass(frozen=True)
class KnownTracker:
    """A laser tracker or total station, what it can see, and the noise of a reading along one axis as its
    section states it: ``sigma0_m``, and ``sigma_per_m`` of range.

    ``one_by_one``: each reading is a distance that is measured by itself, which takes a station seconds.
    ``rate_hz``: so often is it asked for readings; None: it sends them by itself.
    """

    T_base_tracker: Pose
    reflectors: Mapping[str, KnownReflector]
    sigma0_m: float
    sigma_per_m: float
    one_by_one: bool = False
    rate_hz: float | None = None


@dataclass(frozen=True)
class KnownBelt:
    """A belt with its encoder: direction (unit, base), scale, height of its surface, and a point above it.

    ``above`` (3,) is in the base; items come through below it. They are between the two heights.
    ``period_s``: between two positions of the encoder; ``range_counts``: its count goes back to 0 there, None
    where no section tells it. ``stops``: it is stopped and started again and again. ``delay``: of its
    stamps, None: nobody measured it.
    """

    m_per_count: float
    dir: Sequence[float]
    z_m: float
    above: Sequence[float]
    speed_m_s: float
    item_heights_m: tuple[float, float]
    stops: bool = False
    period_s: float = 0.005
    range_counts: int | None = None
    delay: KnownDelay | None = None


@dataclass(frozen=True)
class KnownGripper:
    """A gripper on digital outputs of the arm; ``confirm`` is an input, None when there is none.

    ``place_clear`` is the input that tells whether the place is clear where it puts items down. ``moves_s``:
    it has closed, or opened, within so long as its section says, None where it says nothing.
    """

    output: int
    confirm: int | None
    place_clear: str | None = None
    moves_s: float | None = None


@dataclass(frozen=True)
class KnownMarker:
    """A printed marker beside each slot of a rack: ``id`` at the first one, one more at each next one."""

    dictionary: str
    id: int
    size_m: float
    T_slot_marker: Pose
    sigma_m: float
    sigma_rad: float


@dataclass(frozen=True)
class KnownRack:
    """Slots in rows and columns, and a part that fits into each; the rack's z leads into them.

    ``opening_m`` and ``part_m`` are width, height and, of the part, length. ``T_flange_part`` is the middle
    of the front of a part that is gripped, ``grasp_m`` before the tool's point. A part is in slot
    ``filled``; another one is gripped with the arm at joints ``q_fetch``, or is put into the gripper by a
    person when ``handed``. The sigmas are those of the rack's place and of the part's in the gripper, of
    each axis.
    """

    T_base_rack: Pose
    rows: int
    columns: int
    row_pitch_m: float
    column_pitch_m: float
    opening_m: tuple[float, float]
    chamfer_m: float
    depth_m: float
    part_m: tuple[float, float, float]
    T_flange_part: Pose
    grasp_m: float
    sigma_m: float
    sigma_rad: float
    part_sigma_m: float
    part_sigma_rad: float
    filled: int | None = None
    q_fetch: Sequence[float] | None = None
    handed: bool = False
    marker: KnownMarker | None = None


@dataclass(frozen=True)
class KnownCell:
    """The arm with its tool, and the parts that one job needs.

    ``robot`` is a ROBOT as docs/data-sets.md has it, ``tool`` the section of ``[robot]``.
    """

    robot: Mapping[str, Any]
    tool: Mapping[str, Any]
    payload_kg: float
    q_start: Sequence[float]
    camera: KnownCamera | None = None
    beams: KnownBeams | None = None
    tracker: KnownTracker | None = None
    belt: KnownBelt | None = None
    gripper: KnownGripper | None = None
    rack: KnownRack | None = None
    observed: KnownObserved | None = None
    parts: tuple[str, ...] = field(
        default=("camera", "beams", "tracker", "belt", "gripper", "rack", "observed"), init=False
    )
