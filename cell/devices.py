"""What a device offers. Small Protocols; drivers implement them, procedures use nothing else.

All quantities are SI; poses are ``RigidTransform`` ``T_a_b`` unless a name ends in ``pose6``.
"""

from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cell.arm_model import ArmModel
from cell.joint_limits import leading_speed
from cell.poses import Array, from_pose6
from cell.samples import Readings, Stream

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


class DeviceState(StrEnum):
    """Life of a device as the supervisor drives it."""

    CLOSED = "CLOSED"
    CONNECTING = "CONNECTING"
    READY = "READY"
    DEGRADED = "DEGRADED"
    RETRYING = "RETRYING"
    FAULTED = "FAULTED"


@dataclass(frozen=True)
class Identity:
    """Who a device says it is. Twin serials begin with 9999."""

    model: str
    serial: str
    version: str = ""
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def is_twin(self) -> bool:
        return self.serial.startswith("9999")


@runtime_checkable
class Device(Protocol):
    """Anything with a link. Opening, reconnecting and health are the supervisor's business.

    ``open`` connects once or raises; it never retries. ``wait_lost`` returns the error that ended the link.
    After an error ``close`` and ``open`` again: drivers never reconnect by themselves.
    """

    name: str

    async def open(self) -> None: ...
    async def close(self) -> None: ...
    async def identify(self) -> Identity: ...
    async def wait_fresh(self, timeout: float) -> None:
        """Return when a sample taken after the call has arrived, else ``DEVICE_LOST``."""
        ...

    async def wait_lost(self) -> Exception:
        """Block while the link is good; return what broke it."""
        ...

    def health(self) -> dict[str, Any]:
        """Plain numbers and texts for status pages."""
        ...


class SafetyMode(IntEnum):
    """UR safety modes as RTDE reports them."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


@dataclass(frozen=True, slots=True)
class ArmState:
    """One package of the arm's state stream; SI, base frame.

    ``model``: what says where the flange is at ``q``; None: the controller, by the pose that it reports.
    """

    q: Array  # (6,) joint positions, rad
    qd: Array  # (6,) joint speeds, rad/s
    tcp_pose6: Array  # (6,) pose of the active TCP in base
    tcp_force: Array  # (6,) N and Nm
    tcp_offset6: Array  # (6,) active TCP in the flange, as read back from the controller
    robot_mode: int  # 7 is running
    safety_mode: int
    program_running: bool
    digital_in: int
    digital_out: int
    stamp: float  # controller's own clock, s
    model: ArmModel | None = None
    speed_scaling: float = 1.0  # share of full speed at which the controller runs what it is sent

    @property
    def T_base_flange(self) -> "RigidTransform":
        if self.model is not None:
            return self.model.forward(self.q)
        return from_pose6(self.tcp_pose6) * from_pose6(self.tcp_offset6).inv()

    @property
    def at_rest(self) -> bool:
        """No joint turns faster than 0.002 rad/s (about 1 mm/s at a metre)."""
        return bool(np.max(np.abs(self.qd)) < 0.002)


def flange_poses(states: Sequence[ArmState]) -> "RigidTransform":
    """``T_base_flange`` (n) of many states at once; one by one it would hold up an event loop."""
    if (model := states[0].model) is not None:
        return model.forward_many(np.stack([s.q for s in states]))
    tcp = from_pose6(np.stack([s.tcp_pose6 for s in states]))
    return tcp * from_pose6(np.stack([s.tcp_offset6 for s in states])).inv()


@dataclass(frozen=True)
class Speed:
    """Limits of one move. A driver moves the joint that turns farthest at ``joint_rad_s``."""

    tcp_m_s: float
    tcp_m_s2: float
    joint_rad_s: float
    joint_rad_s2: float
    each_joint_rad_s: tuple[float, ...] = ()  # where joints have limits of their own; see ``between``

    def between(self, q0: Array, q1: Array) -> "Speed":
        """For the joint move from ``q0`` to ``q1`` (6,) rad: so slow that each joint keeps to its limit."""
        if not self.each_joint_rad_s:
            return self
        leading = float(leading_speed(q1 - q0, np.array(self.each_joint_rad_s)))
        return replace(self, joint_rad_s=min(self.joint_rad_s, leading))


@dataclass(frozen=True)
class ToolSettings:
    """What a lease writes into the controller and reads back."""

    T_flange_tool: "RigidTransform"
    payload_kg: float
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TrajectoryPiece:
    """Joint polynomials in cell time: ``q(t) = sum_k coefficients[k] (t - t0)^k`` until ``t1``."""

    t0: float
    t1: float
    coefficients: Array  # (degree + 1, 6)


class MotionPort(Protocol):
    """The arm's motion side; exists only while a lease does. Every call has a deadline of its own."""

    @property
    def usable(self) -> bool:
        """Whether the next move can be asked of it.

        False once the motion client or its script has ended. Where *others* ended the script, and not our own
        watchdog for a silence of ours, this raises ``ARM_SCRIPT_DIED``.
        """
        ...

    @property
    def ended_unseen(self) -> bool:
        """Whether the script ended while no state of the arm came: who ended it is unknown."""
        ...

    async def move_joints(self, q: Array, speed: Speed) -> None:
        """Move in joint space; returns when the *measured* joints agree, else raises."""
        ...

    async def move_linear(self, T_base_flange: "RigidTransform", speed: Speed) -> None:
        """Move the TCP on a line to where the flange has this pose; returns when measured there."""
        ...

    async def stream(self, pieces: AsyncIterator[TrajectoryPiece]) -> None:
        """Follow polynomials as servo set-points; a piece not renewed in time ends in a ramp to rest."""
        ...

    async def guarded_move(
        self, T_base_flange: "RigidTransform", speed: Speed, max_force_n: float, max_travel_m: float
    ) -> bool:
        """Linear move that stops at a force along the way; True when the force ended it."""
        ...

    async def set_tool(self, tool: ToolSettings) -> None:
        """Set another TCP and payload while at rest; returns when they were read back."""
        ...

    async def decelerate(self) -> None:
        """End whatever moves and decelerate; harmless at rest."""
        ...

    async def close(self) -> None:
        """End the motion client; the controller's watchdog takes over if it will not go."""
        ...


class Arm(Device, Protocol):
    """A six-axis arm: state always, motion only through a port that a lease opens."""

    @property
    def state(self) -> Readings[ArmState]:
        """The state stream."""
        ...

    @property
    def expected_lag_s(self) -> float:
        """How late the arm is on the set-points of a stream as far as its settings tell, s."""
        ...

    @property
    def motion_begun(self) -> bool:
        """Whether the latest :meth:`open_motion` got as far as to start a motion client, failed or not."""
        ...

    def check_movable(self) -> None:
        """Raise the coded error that forbids motion now (stale, safety, local mode, foreign program)."""
        ...

    def fault(self) -> Exception | None:
        """The coded error that the newest package shows, or None."""
        ...

    async def open_motion(self, tool: ToolSettings) -> MotionPort:
        """Start the motion client, set and read back TCP and payload. Only a lease calls this."""
        ...

    async def stop_script(self) -> None:
        """Stop ladder, step two: end the motion client and make the controller run a stop."""
        ...

    async def stop_program(self) -> None:
        """Stop ladder, step three: the dashboard's stop."""
        ...


class StartsPrograms(Device, Protocol):
    """An arm whose controller starts a program of its own when it is told to.

    Only for an arm that asked for a check by such a program, while nothing else moves it; no lease guards
    what the program does.
    """

    async def load_program(self, program: str) -> None:
        """Load ``program``, which moves nothing; ``ARM_PROGRAM_NOT_STARTED`` when the controller has none."""
        ...

    async def play_program(self, program: str, last_look: Callable[[], None]) -> None:
        """Start what is loaded; refused unless it is ``program``, the arm may move, and no program runs.

        ``last_look`` is called right before the controller is told; what it raises keeps it from being told.
        """
        ...


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera with OpenCV's distortion; pixel centres at integer coordinates."""

    width: int
    height: int
    K: tuple[float, float, float, float]  # fx, fy, cx, cy
    dist: tuple[float, ...] = ()

    @property
    def matrix(self) -> NDArray[np.float64]:
        fx, fy, cx, cy = self.K
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class BoardView:
    """A detected target in one frame: ``corners[i]`` is the image of target point ``ids[i]``."""

    ids: NDArray[np.int64]  # (n,)
    corners: Array  # (n, 2) pixels
    mean_grey: float


@dataclass(frozen=True, slots=True)
class ItemView:
    """One item wholly in one frame, in the camera frame: the middle of its upper face and how it lies."""

    point: Array  # (3,) m
    axis: Array  # (3,) unit vector along the longer side; its sign has no meaning
    size_m: tuple[float, float]  # length, width
    height_m: float  # above the belt
    sigma_m: float  # of ``point``, per axis, as its rim scatters


@dataclass(frozen=True, slots=True)
class Frame:
    """One exposure as the vision child reports it; ``t_exposure`` is the middle of the first row's exposure.

    A rolling shutter exposes each row ``row_time_s`` after the one before; 0 is a global shutter.
    """

    seq: int
    t_exposure: float
    exposure_s: float
    intrinsics: Intrinsics
    board: BoardView | None
    serial: str
    colour_file: Path | None = None
    depth_file: Path | None = None
    items: tuple[ItemView, ...] | None = None  # None: nobody looked for items
    row_time_s: float = 0.0

    @property
    def exposed_until(self) -> float:
        """When the last row's exposure ended."""
        return self.t_exposure + 0.5 * self.exposure_s + self.row_time_s * self.intrinsics.height

    def t_of(self, point: Array) -> float:
        """When the row was exposed on which ``point`` (3,) of the camera lies.

        Without the lens's distortion: it shifts a row by tens of pixels at most, which is less than a
        millisecond of a rolling shutter.
        """
        _, fy, _, cy = self.intrinsics.K
        row = min(max(fy * float(point[1]) / float(point[2]) + cy, 0.0), float(self.intrinsics.height))
        return self.t_exposure + self.row_time_s * row


class DepthCamera(Device, Protocol):
    """A colour and depth camera whose frames are looked at in a child process."""

    @property
    def frames(self) -> Readings[Frame]:
        """What was seen, stamped by the exposure."""
        ...

    async def set_target(self, target: dict[str, Any] | None) -> None:
        """Choose the board to look for (a capture set's ``target`` table); None looks for nothing."""
        ...

    async def set_items(self, spec: dict[str, Any] | None) -> None:
        """Look for items on a belt too (``ItemSpec`` of ``calibration.items``); None ends that."""
        ...

    async def capture(self, count: int, folder: Path, stem: str, after: float) -> Sequence[Frame]:
        """``count`` frames exposed wholly after ``after``, with colour and depth files in ``folder``.

        Files are ``<stem>-<k>.png`` (colour) and ``<stem>-<k>-depth.png`` (16 bit, mm), on disk when this
        returns. ``DEVICE_LOST`` when frames stop, ``DISK_FAILED`` without the folder.
        """
        ...


@dataclass(frozen=True, slots=True)
class InputsState:
    """All inputs of a module as one poll found them; logical levels, after ``invert``.

    ``changes`` counts every change of an input's level since the epoch began, short pulses between two polls
    included where the module counts edges. Its parity follows the level: two polls with the same level and
    ``changes`` two apart enclose a pulse.
    """

    levels: tuple[bool, ...]
    changes: tuple[int, ...]


class DigitalInputs(Device, Protocol):
    """A group of digital inputs that are read together.

    The :class:`~cell.samples.Sample` of a poll has the middle of request and reply as ``t`` and half of their
    distance as ``dt``; :func:`cell.inputs.edges` turns polls into edges with their bracket.
    """

    names: tuple[str, ...]
    inputs: Stream[InputsState]


@dataclass(frozen=True, slots=True)
class JointState:
    """Joints of an arm that is only observed."""

    q: Array  # (n,) motor side, rad or m
    at_rest: bool
    at_pose: int | None = None  # the number of the pose that the arm's own program says it stands at


class ObservedArm(Device, Protocol):
    """An arm that its own program or an operator moves; we read its joints and ask for poses."""

    axes: int
    period_s: float | None  # nominal interval of its joints; None: they come once, at each rest
    joints: Stream[JointState]

    async def request(self, number: int, q: Array) -> bool:
        """Offer pose ``number`` (from 1) with joints ``q`` (n,) to the arm's program.

        False when the arm has no such handshake, so a person must move it. Number 0 takes a request back.
        """
        ...


@dataclass(frozen=True, slots=True)
class EncoderState:
    """A belt encoder; ``count`` goes on where the device's own range wraps."""

    count: int  # unwrapped since the epoch began
    raw: int  # as the device sent it


class Encoder(Device, Protocol):
    """A counter that turns with a belt."""

    modulus: int  # the device's own range: raw is 0 ... modulus - 1
    period_s: float  # nominal interval of its messages

    @property
    def counts(self) -> Readings[EncoderState]:
        """What it counted."""
        ...


class Gripper(Device, Protocol):
    """Takes and lets go; whether it holds something is measured, where ``confirms``."""

    @property
    def confirms(self) -> bool:
        """Whether anything tells that something is held; without, an empty closing counts as a grip.

        It is on the class: a configuration whose driver lacks it is refused.
        """
        ...

    async def grip(self, timeout: float) -> bool:
        """Close; True when something is held, by the confirm input, within ``timeout`` s."""
        ...

    async def release(self, timeout: float) -> bool:
        """Open; True when nothing is held any more."""
        ...

    def holding(self, max_age: float) -> bool:
        """Whether something is held; ``STALE_DATA`` when the input was not read lately."""
        ...
