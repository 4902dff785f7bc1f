"""The tables of a scenario that describe the arm and its tool."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from cell.errors import CellError
from cell.formats.reading import Strict
from cell.formats.robot import Serial6Robot, parse_robot
from cell.poses import Array
from fakes.world.arm.controller_limits import ControllerLimitsTruth
from fakes.world.arm.kinematics import CB3_MODELS, MODELS, LinkDeltas, dh_parameters
from fakes.world.beams.truth import CapsuleTruth, Three

CB3_VERSION = "3.15.0"

Lag = Literal["none", "delay", "low-pass"]
Six = Annotated[list[float], Field(min_length=6, max_length=6)]


class Links(Strict):
    """Deviations of the arm's links, rad and m, as UR's calibration lists them."""

    delta_theta: Six = [0.0] * 6
    delta_d: Six = [0.0] * 6
    delta_a: Six = [0.0] * 6
    delta_alpha: Six = [0.0] * 6

    def deltas(self) -> LinkDeltas:
        return LinkDeltas.from_mapping(self.model_dump())


class JointErrorsTruth(Strict):
    """``[world.arm.joint_errors]``: how far joints turn beyond what they read, amplitudes in rad.

    Every joint has the two errors of its gear; where in the turn they begin is drawn from the seed.
    """

    gear_once_rad: float = Field(default=0.0, ge=0, le=0.01, description="once a turn of each joint")
    gear_twice_rad: float = Field(default=0.0, ge=0, le=0.01, description="twice a turn of each joint")
    sag_rad: Three = Field(
        default=[0.0] * 3,
        description="of a level arm: joint 2 under the upper arm and under the forearm, joint 3 under it",
    )


class ServoTruth(Strict):
    """``[world.arm.servo]``: how the arm follows set-points; see :mod:`fakes.world.arm.servo`."""

    lag: Lag = Field(
        default="none",
        description="none: on each set-point at once, whatever the speed slider and the joints' limits",
    )
    more_s: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="later than look-ahead and gain make it, as where set-points come through a slow network",
    )
    ripple_s: float = Field(
        default=0.0,
        ge=0,
        le=0.002,
        description="times a joint's speed: how far it is beside its set-points at most; needs a lag",
    )

    @model_validator(mode="after")
    def _follows(self) -> Self:
        for key in ("ripple_s", "more_s"):
            if getattr(self, key) and self.lag == "none":
                raise ValueError(f"{key} needs a lag other than none")
        return self


class ReportedTruth(Strict):
    """``[world.arm.reported]``: how far what the controller reports is off what is so."""

    q_noise_rad: float = Field(default=0.0, ge=0, le=0.001, description="sigma of each joint")
    qd_noise_rad_s: float = Field(default=0.0, ge=0, le=0.01, description="sigma of each joint's speed")
    force_bias_n: float = Field(default=0.0, ge=0, le=50, description="of the TCP force, in one direction")
    force_walk_n: float = Field(default=0.0, ge=0, le=50, description="of each of the slow waves in it")
    stamp_late_s: float = Field(
        default=0.0,
        ge=0,
        le=0.02,
        description="joints, speeds and the TCP's pose were so as much before their stamp; when in a cycle a "
        "controller reads its joints is not published",
    )


class ArmTruth(Strict):
    """The robot: what its controller believes, and how far the true one is from that."""

    model: str = ""
    robot: dict[str, Any] | None = Field(
        default=None, description="a ROBOT of family serial6, for an arm of another maker than UR"
    )
    serial: str = Field(
        default="99991100001", pattern=r"^9999\d+$", description="twin serials begin with 9999"
    )
    version: str = Field(
        default="5.12.4", pattern=r"^\d+\.\d+", description=f"{CB3_VERSION} of {', '.join(CB3_MODELS)}"
    )
    q_start: Six
    factory: Links = Links()
    error: Links = Links()
    joint_errors: JointErrorsTruth = JointErrorsTruth()
    servo: ServoTruth = ServoTruth()
    reported: ReportedTruth = ReportedTruth()
    controller_limits: ControllerLimitsTruth = ControllerLimitsTruth()
    repeatability_t_m: float = Field(
        default=0.0,
        ge=0,
        le=0.01,
        description="sigma per axis, new at each standstill; ISO 9283's RP of a data sheet is 3.6 times that",
    )
    repeatability_r_rad: float = Field(default=0.0, ge=0, le=0.01)

    @model_validator(mode="before")
    @classmethod
    def _its_own_version(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("model") in CB3_MODELS:
            return {"version": CB3_VERSION, **given}
        return given

    @model_validator(mode="after")
    def _known_model(self) -> Self:
        if self.robot is not None:
            if self.model:
                raise ValueError("give model or robot, not both")
            self.serial6()
        elif self.model not in MODELS:
            raise ValueError(f"model {self.model!r} is not known; known are {', '.join(MODELS)}")
        elif (self.model in CB3_MODELS) != self.version.startswith("3."):
            raise ValueError(
                f"no {self.model.upper()} has version {self.version}: "
                f"{', '.join(CB3_MODELS)} have controllers of version 3, all others later ones"
            )
        return self

    def serial6(self) -> Serial6Robot | None:
        """The arm as its ROBOT has it; None for an arm of UR."""
        if self.robot is None:
            return None
        try:
            found = parse_robot(self.robot, "robot")
        except CellError as exc:
            raise ValueError(exc.detail) from exc
        if not isinstance(found, Serial6Robot):
            raise ValueError(f"robot is of family {self.robot.get('family')!r}, and a twin moves serial6")
        return found

    @property
    def name(self) -> str:
        """Of the model, as the controller tells it."""
        return self.model if self.robot is None else str(self.robot["name"])

    def ranges(self) -> Array:
        """(6, 2) rad: from where to where the joints turn; UR's turn twice around each way."""
        robot = self.serial6()
        return np.array([[-2.0 * np.pi, 2.0 * np.pi]] * 6 if robot is None else robot.joint_limits)

    def drawing(self, deltas: LinkDeltas) -> tuple[Array, Array, Array, Array]:
        """Denavit-Hartenberg ``theta, d, a, alpha`` (6,), rad and m, with ``deltas`` added."""
        robot = self.serial6()
        if robot is None:
            return dh_parameters(self.model, deltas)
        theta, d, a, alpha = (
            np.array([getattr(link, key) for link in robot.links]) + getattr(deltas, f"delta_{key}")
            for key in ("theta", "d", "a", "alpha")
        )
        return theta, d, a, alpha


def _pin() -> list[CapsuleTruth]:
    """60 mm long, 3 mm in radius, with the tool's point as its lowest one."""
    return [CapsuleTruth.model_validate({"from": [0, 0, -0.003], "to": [0, 0, -0.057], "radius_m": 0.003})]


class ToolTruth(Strict):
    """What is mounted on the flange, as nominal, and the shape of its end in the tool frame."""

    name: str = "gripper"
    T_flange_tool: Six = Field(default=[0.0, 0.0, 0.18, 0.0, 0.0, 0.0])
    radius_m: float = Field(default=0.03, gt=0, le=0.5)
    payload_kg: float = Field(default=1.2, ge=0, le=50)
    shape: list[CapsuleTruth] = Field(default_factory=_pin, min_length=1)
    lean_rad: tuple[float, float] = Field(
        default=(0.0, 0.0),
        description="the shape stands turned by this about the tool's x and y, at its point",
    )
