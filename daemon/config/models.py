"""The fixed sections of ``cell.toml``. SI units; every key ends in its unit, every number has bounds."""

from datetime import date
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from cell.errors import present
from daemon.config.faces import CanSection, HttpSection, ModbusSection
from daemon.config.limits_section import LimitsSection
from daemon.config.mqtt_section import MqttSection
from daemon.config.program_after import ProgramAfter
from daemon.config.recipes import NAME as RECIPE_NAME
from daemon.config.section import GrownSection, Point, Pose6, Section, absolute
from daemon.config.tools import NAME as TOOL_NAME
from daemon.config.tools import NamedToolSection

UR_MODELS = (
    "ur3", "ur5", "ur10", "ur3e", "ur5e", "ur7e", "ur10e", "ur12e", "ur16e",
    "ur8long", "ur15", "ur18", "ur20", "ur30",
)  # fmt: skip
MAX_SOCKET_PATH = 107  # sun_path of AF_UNIX without its final zero


class DeviceSection(Section):
    """What every ``[device.NAME]`` may hold; every other key is the driver's own."""

    driver: str = Field(description="a short name, or package.module:Class")
    calibrated: date | None = Field(
        default=None,
        description="day of the instrument's last calibration, 2026-05-31 for instance; for reports",
    )

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to another process, a section is the driver's own ``Config``: its class here has no name."""
        config: Any = type(self).__bases__[-1]
        return config.model_validate, (self.model_dump(include=set(config.model_fields)),)


def _socket(value: str) -> str:
    if len(absolute(value).encode()) > MAX_SOCKET_PATH:
        raise ValueError(f"a socket's path has at most {MAX_SOCKET_PATH} bytes")
    return value


Joints = Annotated[list[float], Field(min_length=6, max_length=6)]


class KeepSection(Section):
    """What ``cellward prune`` keeps; nothing is removed unless somebody, or a timer, gives that command."""

    runs: int | None = Field(
        default=None, ge=1, le=10_000_000, description="so many runs are kept, the newest ones"
    )
    age_days: float | None = Field(
        default=None, ge=0, le=36500, description="runs that are not older than this are kept"
    )
    size_gb: float | None = Field(
        default=None, gt=0, le=1e6, description="largest size of all run folders together, in 10^9 bytes"
    )


class CellSection(Section):
    """Who this cell is and where it keeps its state."""

    name: str = Field(
        default="cell",
        min_length=1,
        max_length=64,
        pattern=r"^[\w. -]+$",
        description="name of the cell, as status and reports show it",
    )
    twin: bool = Field(
        default=False,
        description="true takes only simulated devices (serial numbers 9999...), false only real ones",
    )
    state_dir: Annotated[str, AfterValidator(absolute)] = Field(
        default="/var/lib/cellward", description="run folders and the ledger"
    )
    control_socket: Annotated[str, AfterValidator(_socket)] = Field(
        default="/run/cellward/control.sock",
        description="Unix socket where the command line reaches the daemon",
    )
    clock: str | None = Field(
        default=None,
        pattern=r"^[\w.]+:\w+$",
        description="another clock as package.module:Class; only for a twin",
    )
    record: bool = Field(
        default=False,
        description="true: every byte to and from the devices is kept below state_dir/recordings",
    )
    record_mb: int = Field(
        default=1000,
        ge=16,
        le=1_000_000,
        description="size of all recordings together, in 10^6 bytes; the oldest part goes",
    )
    keep: KeepSection | None = Field(
        default=None, description="bounds that 'cellward prune' keeps to; without them it needs its options"
    )


class SupervisorSection(Section):
    """When the event loop counts as late, and how much silence of a device a run bears."""

    loop_lag_warn_s: float = Field(
        default=0.02, gt=0, le=1.0, description="a later wake-up of the event loop is logged"
    )
    loop_lag_fail_s: float = Field(
        default=0.5,
        gt=0,
        le=5.0,
        description="above it the watchdog of systemd is not fed",
    )
    silence_s: float = Field(
        default=2.0,
        ge=0,
        le=10.0,
        description="a device that is back within it costs a step, not the run; 1.5 s more for one that has "
        "to be connected anew",
    )
    silences_in_a_row: int = Field(
        default=3, ge=1, le=100, description="so many without a finished step between them end the run"
    )
    silences_in_all: int = Field(default=10, ge=1, le=1000, description="so many end the run")
    ask_after_lost_arm: bool = Field(
        default=False,
        description="true: where no states of the arm came when its script ended, or its link was lost, "
        "the job is Held until somebody says resume: a stop at the pendant or a safeguard that reset itself "
        "meanwhile left no trace",
    )


class ToolSection(Section):
    """The tool on the flange: a capsule from the flange to the tool's point."""

    name: str = Field(default="flange", description="calibrations of the tool belong to this name")
    T_flange_tool: Pose6 = Field(
        default_factory=lambda: [0.0] * 6,
        description="nominal pose of the tool's point in the flange",
    )
    radius_m: float = Field(
        default=0.03, gt=0, le=1.0, description="of the capsule that stands for the tool in checks of motion"
    )


class NominalBelt(Section):
    """The nominal values of the belt: the way of a count, or the wheel that the encoder sits on."""

    m_per_count: float | None = Field(
        default=None, ge=-0.1, le=0.1, description="way of the belt for one count of its encoder, m"
    )
    wheel_circumference_m: float | None = Field(
        default=None, gt=0, le=100.0, description="of the encoder's wheel on the belt, instead of m_per_count"
    )
    counts_per_revolution: int | None = Field(
        default=None, description="of the encoder; negative where it counts down as the belt goes on"
    )
    dir: Point = Field(description="direction in which the belt runs, in the base")

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        wheel = (self.wheel_circumference_m, self.counts_per_revolution)
        if (self.m_per_count is None) == (wheel == (None, None)) or (wheel != (None, None) and None in wheel):
            raise ValueError("give m_per_count, or wheel_circumference_m and counts_per_revolution")
        if 0 in (self.m_per_count, self.counts_per_revolution):
            raise ValueError("m_per_count and counts_per_revolution must not be 0")
        if not 0.99 < sum(v * v for v in self.dir) < 1.01:
            raise ValueError("dir must be a unit vector")
        return self

    @property
    def scale(self) -> float:
        """m of one count, signed."""
        if self.m_per_count is not None:
            return self.m_per_count
        return present(self.wheel_circumference_m, "wheel") / present(self.counts_per_revolution, "counts")


class RobotSection(GrownSection):
    """Which device plays which role, and what is mounted on the arm."""

    LATER: ClassVar = frozenset({"program_after"})

    arm: str | None = Field(default=None, description="device: the arm that is moved")
    observed_arm: str | None = Field(default=None, description="device: an arm that is read, not moved")
    flange_camera: str | None = Field(default=None, description="device: the camera on the flange")
    fixed_camera: str | None = Field(default=None, description="device: the camera that stands in the cell")
    beams: str | None = Field(default=None, description="device: the digital inputs of the crossed beams")
    belt: str | None = Field(default=None, description="device: the encoder of the belt")
    tracker: str | None = Field(default=None, description="device: the laser tracker or total station")
    gripper: str | None = Field(default=None, description="device: the gripper")
    place_inputs: str | None = Field(
        default=None, description="device: the digital inputs that tell whether a place is clear"
    )
    T_flange_camera_nominal: Pose6 | None = Field(default=None, description="nominal pose, the first guess")
    T_base_camera_nominal: Pose6 | None = Field(
        default=None, description="first guess of a fixed camera's pose"
    )
    T_flange_target_nominal: Pose6 | None = Field(
        default=None, description="nominal pose of the target on the flange"
    )
    belt_nominal: NominalBelt | None = Field(
        default=None, description="scale and direction of the belt until belt-calibration has measured them"
    )
    model: str = Field(
        default="ur10e", min_length=1, description=f"{', '.join(UR_MODELS)}, or a ROBOT file (JSON)"
    )
    observed_model: str | None = Field(
        default=None, min_length=1, description="ROBOT file (JSON) of the observed arm"
    )
    use_kinematics: bool = Field(
        default=False,
        description="the daemon's own moves and poses go by the calibrated kinematics of the arm in effect "
        "(accepted results of tracker-sampling), not by the model of its controller",
    )
    payload_kg: float = Field(
        default=0.0,
        ge=0,
        le=100.0,
        description="mass on the flange, tool included; at most what the arm carries. Absent: no job moves "
        "the arm of a cell that is no twin",
    )
    centre_of_mass_m: Point = Field(
        default_factory=lambda: [0.0] * 3, description="centre of mass of the payload, in the flange, m"
    )
    tool: ToolSection = Field(default_factory=lambda: ToolSection(), description="the tool on the flange")
    program_after: ProgramAfter | None = Field(
        default=None,
        description="the arm's own program that is started again after a check it asked for",
    )


class DueAfter(Section):
    """When a calibration wants to be checked: after a time, after so many runs, or what comes first."""

    max_age_h: float | None = Field(
        default=None, gt=0, le=100000.0, description="since it was measured, or a check of it passed, h"
    )
    max_runs: int | None = Field(
        default=None, ge=1, le=10000000, description="so many runs of other jobs since then"
    )

    @model_validator(mode="after")
    def _says_when(self) -> Self:
        if self.max_age_h is None and self.max_runs is None:
            raise ValueError("give max_age_h, max_runs or both")
        return self


class CheckDueSection(Section):
    """When a calibration wants to be checked again: a warning, and nothing starts by itself."""

    T_flange_camera: DueAfter | None = Field(default=None, description="pose of the camera on the flange")
    T_base_camera: DueAfter | None = Field(default=None, description="pose of the camera in the cell")
    T_flange_tool: DueAfter | None = Field(default=None, description="tool frame of each tool")
    laser_reference: DueAfter | None = Field(
        default=None, description="reference of each tool in the crossed beams"
    )
    kinematics: DueAfter | None = Field(default=None, description="of each arm")
    belt: DueAfter | None = Field(default=None, description="scale and direction of the belt")
    time_offset_s: DueAfter | None = Field(
        default=None, description="delay of the stamps of each source that has one"
    )


class FixedSections(Section):
    """All of ``cell.toml`` whose shape does not depend on drivers, jobs or the type of a target."""

    schema_number: Literal[1] = Field(alias="schema", description="of this file")
    cell: CellSection = Field(default_factory=lambda: CellSection(), description="who this cell is")
    supervisor: SupervisorSection = Field(
        default_factory=lambda: SupervisorSection(), description="when the daemon is late"
    )
    robot: RobotSection = Field(default_factory=lambda: RobotSection(), description="roles, arm and tool")
    limits: LimitsSection = Field(default_factory=lambda: LimitsSection(), description="of every motion")
    poses: dict[str, Joints] = Field(default_factory=dict, description="named safe poses, always joints, rad")
    modbus: ModbusSection = Field(default_factory=lambda: ModbusSection(), description="the server for a PLC")
    can: CanSection = Field(default_factory=lambda: CanSection(), description="the CAN trigger")
    http: HttpSection = Field(
        default_factory=lambda: HttpSection(enabled=False), description="the operator's page"
    )
    check_due: CheckDueSection = Field(
        default_factory=lambda: CheckDueSection(), description="when a calibration wants to be checked again"
    )
    mqtt: MqttSection = Field(default_factory=lambda: MqttSection(), description="the broker of a plant")
    tool: dict[Annotated[str, Field(pattern=TOOL_NAME)], NamedToolSection] = Field(
        default_factory=dict, description="one table a tool, [tool.NAME], in a cell that has several"
    )
    device: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="one table a device, [device.NAME]"
    )
    target: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="one table a calibration target, [target.NAME]"
    )
    job: dict[str, dict[str, Any]] = Field(default_factory=dict, description="one table a job, [job.NAME]")
    recipe: dict[Annotated[str, Field(pattern=RECIPE_NAME)], dict[str, Any]] = Field(
        default_factory=dict, description="one table a recipe, [recipe.NAME]"
    )
