"""The results of the crossed-beam jobs, field by field."""

from math import hypot
from typing import Annotated, Any, Literal

from pydantic import Field

from cell.calibrations import tool_calibration
from cell.formats.main_figure import MainFigure
from cell.formats.result import (
    Covariance,
    Empty,
    Envelope,
    Figures,
    Inputs,
    Metres,
    MetresPerSecond,
    Part,
    Pose,
    Radians,
    Seconds,
    Turn,
    Unit,
    Vector,
)

Height = Annotated[list[float], Field(min_length=2, max_length=2), Unit("m")]
Lengths = Annotated[list[float], Unit("m")]
SetName = Literal["reference", "current"]


class RejectedPass(Part):
    """A pass that tells nothing across the beams."""

    set_: SetName = Field(alias="set", description="Measurement that it is of.")
    index: int = Field(description="Its number there.")
    beam: str = Field(description="`xs` or `ys`.")
    reason: str = Field(description="Why it was not used.")


class Apart(Part):
    """How far a tool frame is from another one."""

    shift_m: Vector = Field(description="Of the point, in the flange.")
    shift: Metres = Field(description="Its length.")
    tilt_rad: Radians = Field(description="Of the axis.")


class MovedTest(Part):
    """The test of a check: whether the tool has moved against the frame in effect."""

    moved: bool = Field(description="What came of it.")
    shift_m: Metres = Field(description="How far the point moved.")
    U_shift_m: Metres = Field(description="95 % of the errors of that stay below this.")
    tolerance_m: Metres = Field(description="Beyond this the tool has moved.")
    detectable_m: Metres | None = Field(default=None, description="A shift found in 99 of 100 checks.")
    false_alarm: float | None = Field(
        default=None, description="Chance, at most, of calling a tool moved that has not (1)."
    )
    tilt_rad: Radians | None = Field(description="By how much the axis turned; null: not measured.")
    U_tilt_rad: Radians | None = Field(description="95 % of the errors of that stay below this.")
    tolerance_rad: Radians | None = Field(description="Beyond this the tool has moved.")


class LaserAnswer(Part):
    """How the tool's point and axis differ from the reference."""

    dp_flange: Vector = Field(description="Displacement of the point, now minus reference, in the flange.")
    drot_flange: Turn | None = Field(
        description="Smallest turn of the reference's axis to the current one; null with one height."
    )
    flange_offset_base: Vector = Field(
        description="Where the flange was with the point at the beams, now minus reference, in the base."
    )
    p_new: Vector = Field(description="The point in the flange.")
    axis_new: list[float] | None = Field(description="The axis in the flange (1).")
    tau: Seconds | None = Field(description="How much later the input is than its stamps say.")
    hysteresis_m: Metres | None = Field(description="Shift of the edges along the way; null with one speed.")
    lag_s: Seconds | None = Field(
        description="How much later the input clears than it breaks; null unless several speeds show it."
    )
    cov: Covariance | None = Field(
        description="Displacement, then turn, in the axes of the flange; zero in what is not determined."
    )
    rejected: list[RejectedPass] = Field(description="Every pass that was not used.")
    source_rule_dp: Vector | None = Field(
        default=None, description="`--method classic`: what the published rule adds; never applied."
    )
    T_flange_tool: Pose | None = Field(default=None, description="Of a run: the tool frame as measured.")
    against_reference: Apart | None = Field(default=None, description="Of a run: from the reference's tool.")
    against_last: Apart | None = Field(default=None, description="Of a run: from the frame in effect.")
    latency_s: Seconds | None = Field(
        default=None, description="Of a run: delay of the inputs in all, with what is taken off already."
    )
    moved: MovedTest | None = Field(default=None, description="Of a check that asked for it.")


class LaserUncertainty(Part):
    """Lengths and angle that 95 % of the errors stay below. Empty with the classic method."""

    U_xy_m: Metres | None = Field(default=None, description="Of the point across its axis.")
    U_z_m: Metres | None = Field(default=None, description="Of the point along its axis.")
    U_point_m: Metres | None = Field(default=None, description="Of the point.")
    U_tilt_rad: Radians | None = Field(default=None, description="Of the axis.")
    sigma_m: Vector | None = Field(default=None, description="Standard deviations of the point.")
    sigma_rad: Turn | None = Field(default=None, description="Standard deviations of the turn.")
    sigma_tau_s: Seconds | None = Field(default=None, description="Standard deviation of `tau`.")
    sigma_hysteresis_m: Metres | None = Field(default=None, description="Of the hysteresis.")
    sigma_lag_s: Seconds | None = Field(default=None, description="Of `lag_s`.")
    noise_m: Metres | None = Field(default=None, description="Standard deviation of an edge.")
    effective_points: float | None = Field(
        default=None, description="Independent Monte Carlo points that the means are worth (1)."
    )


class PassResidual(Part):
    """One pass that shows the tool."""

    set_: SetName = Field(alias="set", description="Measurement that it is of.")
    index: int = Field(description="Its number there.")
    beam: str = Field(description="`xs` or `ys`.")
    dir: int = Field(description="1 out, -1 back.")
    above_m: Metres = Field(description="Height of the reference's point over the beam; below it: negative.")
    edges: int = Field(description="Edges that were seen.")
    chord_m: Metres = Field(description="Length in the beam.")
    speed_m_s: MetresPerSecond = Field(description="Of the flange.")
    speed_change: float | None = Field(description="Share by which the speed changed (1).")
    centre_m: Metres = Field(description="Middle of the chord across the beam.")
    used: bool = Field(description="Whether the solution used it.")
    rms_m: Metres | None = Field(description="Of its edges.")
    narrower_m: Metres | None = Field(
        default=None, description="By how much less each edge is out, near the tool's end."
    )


class OutBack(Part):
    """A way out and the way back, with the delay removed."""

    set_: SetName = Field(alias="set", description="Measurement that they are of.")
    beam: str = Field(description="`xs` or `ys`.")
    indices: list[int] = Field(description="Numbers of the two passes.")
    m: Metres = Field(description="Centre out minus back.")


class LaserResiduals(Part):
    """How the edges agree with the answer. That is no accuracy."""

    rms_m: Metres = Field(description="Of all edges that were used.")
    expected_m: Metres = Field(description="What a perfect solution would have.")
    per_pass: list[PassResidual] = Field(description="Every pass that shows the tool.")
    out_back: list[OutBack] = Field(description="Ways out and back.")


class LaserHeldOut(Part):
    """Edges judged by solutions without their fifth of the passes. Empty with too few passes."""

    rms_m: Metres | None = Field(default=None, description="Of the edges.")
    expected_m: Metres | None = Field(default=None, description="What a perfect solution would have.")
    edges: int | None = Field(default=None, description="How many were judged.")
    passes: int | None = Field(default=None, description="How many passes they are of.")


class LaserObservability(Part):
    """What the passes determine."""

    rank: int = Field(description="Directions of the tool frame that are determined.")
    of: int = Field(description="All of them.")
    undetermined: list[str] = Field(description="The others, in words.")
    unknowns: list[str] = Field(description="Numbers that were solved for across the beams.")
    own_tilt_rad: dict[str, Radians | None] = Field(description="Tilt as each beam shows it.")
    edges_m: dict[str, Lengths] = Field(description="Edges across each beam.")
    heights_m: dict[str, Height] | None = Field(
        default=None,
        description="By set and beam, flange height of the first contact; its standard deviation.",
    )
    brackets_m: dict[str, Any] | None = Field(
        default=None,
        description="Of earlier versions: heights between which the tip is.",
    )
    lever_m: dict[str, Metres] = Field(
        description="By beam, mean height above the point at which the tool was crossed."
    )


class Passes(Part):
    """How many passes there are."""

    reference: int = Field(description="Of the reference.")
    current: int = Field(description="Of this measurement.")


class SecondScan(Part):
    """The scan with the new frame, against the reference."""

    meets: bool = Field(description="Whether the point is where the reference has it.")
    apart: Metres | None = Field(description="How far off it is; null when the scan cannot be solved.")
    U_m: Metres | None = Field(default=None, description="Beyond this the frame is turned down.")
    scans: int | None = Field(default=None, description="How many were taken.")
    false_alarm: float | None = Field(
        default=None, description="Chance, at most, of turning a right frame down (1)."
    )
    apart_m: Vector | None = Field(default=None, description="How far off it is, in the base.")
    detectable_m: Metres | None = Field(default=None, description="An error found in 99 of 100.")
    U_point_m: Metres | None = Field(default=None, description="95 % of the scan's errors stay below this.")
    reasons: list[str] | None = Field(default=None, description="Why it cannot be solved.")


class Update(Part):
    """What became of the new tool frame."""

    committed: bool | None = Field(default=None, description="Whether it is in effect.")
    accepted_by: str | None = Field(default=None, description="Who decided so.")
    why: str | None = Field(default=None, description="Why it is not.")
    controller_tool: str | None = Field(default=None, description="TCP that the controller was left with.")
    second_scan: SecondScan | None = Field(default=None, description="The scan with the new frame.")


class LaserInputs(Inputs):
    """What was solved."""

    path: str = Field(description="The data set.")
    method: str = Field(description="Solver.")
    tool: str | None = Field(description="Name of the tool.")
    passes: Passes = Field(description="In the data set.")
    update: Update | None = Field(default=None, description="Of `laser-update`.")


class LaserResult(Envelope):
    """The tool frame by two crossed light beams: a check or an update."""

    kind: Literal["laser"] = "laser"
    result: LaserAnswer
    uncertainty: LaserUncertainty
    residuals: LaserResiduals
    heldout: LaserHeldOut
    observability: LaserObservability
    inputs: LaserInputs

    def figures(self) -> Figures:
        """Displacement, tilt and uncertainty of the tool; an update that was not committed does not stand."""
        found, update = self.result, self.inputs.update
        return Figures(
            tool_offset_m=found.dp_flange,
            tool_tilt_rad=hypot(*(found.drot_flange or [0.0])),
            predicted_95_m=self.uncertainty.U_point_m or 0.0,
            tool_moved=found.moved is not None and found.moved.moved,
            stands=update is None or update.committed is True,
        )

    def exported(self) -> tuple[str, Any] | None:
        pose = self.result.T_flange_tool
        return None if pose is None else (tool_calibration(self.inputs.tool or "tool"), pose)

    def main_figure(self) -> MainFigure:
        off = hypot(*self.result.dp_flange)
        return MainFigure("tool_off_m", "point off the reference", off, "m", self.uncertainty.U_point_m)


class BeamLine(Part):
    """A beam as a line."""

    point: Vector = Field(description="A point of it, in the base.")
    dir: list[float] = Field(description="Unit vector along it, in the base (1).")


class Plane(Part):
    """How well the two beams lie in one level plane."""

    gap_m: Metres = Field(description="Height between the two where they cross.")
    U_gap_m: Metres | None = Field(description="95 % of the errors of that stay below this.")
    slope_rad: dict[str, Radians] = Field(description="Rise of each beam against base x-y.")


class ReferenceAnswer(Part):
    """Where the beams are, and what later measurements are held against."""

    beams: dict[str, BeamLine] = Field(description="By name.")
    hits: dict[str, Vector | None] = Field(description="By beam, the flange with the point in it.")
    tau: Seconds | None = Field(description="How much later the inputs are than their stamps say.")
    hysteresis_m: Metres | None = Field(description="Shift of the edges along the way; null with one speed.")
    lag_s: Seconds | None = Field(
        description="How much later the input clears than it breaks; null unless several speeds show it."
    )
    plane: Plane = Field(description="How level and flat the beams are.")
    axis_turn_flange: Turn | None = Field(description="Turn of the tool's axis that the passes show.")
    cov: Covariance = Field(description="Of the tool's point in the beams, in the axes of the flange.")
    tau_s: Seconds | None = Field(default=None, description="Of a run: as `tau`.")
    schema_: str | None = Field(default=None, alias="schema", description="Of a run: of the calibration.")
    tool: dict[str, Any] | None = Field(default=None, description="Of a run: as in a data set of beams.")
    R_base_flange: Turn | None = Field(default=None, description="Of a run: attitude of the flange.")
    search: dict[str, Any] | None = Field(default=None, description="Of a run: keys of the job and poses.")
    T_flange_tool: Pose | None = Field(default=None, description="Of a run: tool frame of the reference.")
    time_offset_s: Seconds | None = Field(default=None, description="Of a run: taken off the stamps.")
    passes: list[Any] | None = Field(
        default=None,
        description="Of a run: each pass of the data set of beams, as JSON compressed by zlib in base64.",
    )


class BeamUncertainty(Part):
    """Of one beam."""

    sigma_point_m: Vector = Field(description="Standard deviations of its point.")
    sigma_dir: list[float] = Field(description="Standard deviations of its direction (1).")
    places_apart_m: Metres = Field(description="Distance of the places where it was crossed.")


class ReferenceUncertainty(Part):
    """Of the answer."""

    U_point_m: Metres = Field(description="95 % of the errors of the tool's point stay below this.")
    sigma_tau_s: Seconds | None = Field(description="Standard deviation of `tau`.")
    beams: dict[str, BeamUncertainty] = Field(description="By name.")
    noise_m: Metres = Field(description="Standard deviation of an edge.")


class RejectedReferencePass(Part):
    """A pass that tells nothing across the beams."""

    index: int = Field(description="Its number in the data set.")
    beam: str = Field(description="`xs` or `ys`.")
    reason: str = Field(description="Why it was not used.")


class ReferenceResiduals(Part):
    """How the passes agree."""

    out_back_rms_m: Metres | None = Field(description="RMS of centres out minus back.")
    out_back_max_m: Metres | None = Field(description="The largest of them.")
    chord_m: dict[str, Metres] = Field(description="Length in each beam.")
    rejected: list[RejectedReferencePass] = Field(description="Every pass that was not used.")


class ReferenceObservability(Part):
    """What is open."""

    undetermined: list[str] = Field(description="In words.")


class ReferenceResult(Envelope):
    """The beams that later measurements of a tool refer to."""

    kind: Literal["laser-reference"] = "laser-reference"
    result: ReferenceAnswer
    uncertainty: ReferenceUncertainty
    residuals: ReferenceResiduals
    heldout: Empty = Field(description="Empty.")
    observability: ReferenceObservability
    inputs: LaserInputs

    def figures(self) -> Figures:
        """The uncertainty of the tool's point."""
        return Figures(predicted_95_m=self.uncertainty.U_point_m)

    def main_figure(self) -> MainFigure:
        return MainFigure("U_point_m", "95 % error of the tool's point", self.uncertainty.U_point_m, "m")
