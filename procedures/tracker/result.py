"""The result of a kinematic calibration, field by field."""

from typing import Annotated, Any, Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import (
    Covariance,
    Envelope,
    Explained,
    Figures,
    Inputs,
    Kilograms,
    Metres,
    Part,
    Pose,
    Radians,
    Rejected,
    Seconds,
    Unit,
    Vector,
)


class NoiseInUse(Part):
    """Noise of the readings that the solution was weighted by."""

    sigma0: Metres = Field(description="Constant part of the standard deviation along one axis.")
    sigma_per_m: float = Field(description="Its part for each metre of range (m/m).")
    given: bool = Field(description="Whether the data set says so; else it comes from the residuals.")
    excess: float = Field(description="Factor of the covariance, as the residuals exceed the noise.")
    sigma_constant: Metres | None = Field(
        default=None, description="Standard deviation of the reflector's constant, as given."
    )


class Accuracy(Part):
    """Of reflectors in the tracker frame."""

    before: Metres | None = Field(description="The nominal arm in its best place.")
    after: Metres | None = Field(
        description="On poses that the solver did not see, with the tracker's noise."
    )
    predicted_95: Metres = Field(description="95 % of errors stay below this at the worst place.")
    direction: str = Field(description="The same in words.")


class ClassicRun(Part):
    """How the classic method ended."""

    iterations: int = Field(description="Steps that it took.")
    stopped: str = Field(description="Rule that stopped it.")


class JointErrorSizes(Explained):
    """How far joints turn beyond what they read."""

    gear_rad: Radians | None = Field(description="RMS amplitude of the gears' errors; null: none is seen.")
    sag_rad: Radians | None = Field(description="The same of what gives way under the arm's weight.")


class KincalAnswer(Part):
    """The calibrated arm."""

    parameters: dict[str, float] = Field(description="Its numbers by name (m, rad, 1).")
    nominal: dict[str, float] = Field(description="Those of the nominal arm.")
    sigma: dict[str, float | None] | None = Field(
        description="Their standard deviations; null where only a combination is determined."
    )
    rank: int = Field(description="Parameters that the readings determine with the tracker's place free.")
    rank_without_registration: int = Field(description="The same with that place known.")
    unidentifiable: list[str] = Field(description="What they leave open: combinations, in words.")
    T_tracker_base: Pose = Field(description="The arm's base in the tracker.")
    direction: str = Field(description="The same in words.")
    rms_nominal: Metres | None = Field(
        description="Held-out distance from the readings of the nominal arm, the tracker where it was found."
    )
    rms_registration_only: Metres | None = Field(description="Of the nominal arm in its best place.")
    rms_calibrated: Metres | None = Field(description="Of the calibrated arm.")
    rms_calibrated_all: Metres | None = Field(
        default=None, description="The same with the readings that the solution left out."
    )
    robot: dict[str, Any] = Field(description="The calibrated arm as a ROBOT.")
    noise: NoiseInUse = Field(description="Noise in use.")
    joint_errors: JointErrorSizes | None = Field(
        default=None, description="Errors of gears and sag in `robot`; null where too few readings tell."
    )
    reflector_constant_m: Metres | None = Field(
        default=None, description="What all ranges were too long by; 0 without `sigma_constant`."
    )
    rejected: list[Rejected] = Field(description="Samples that were not used.")
    payload_kg: Kilograms | None = Field(description="Load of the arm.")
    classic: ClassicRun | None = Field(default=None, description="With `--method classic`.")
    p_tracker: list[Vector] | None = Field(
        default=None, description="With `--predict`: where the tracker would read the reflector."
    )
    p_tracker_95: list[Metres] | None = Field(default=None, description="95 % of errors stay below these.")
    q: list[list[float] | None] | None = Field(
        default=None, description="With `--targets`: joints that get there (rad or m); null out of reach."
    )
    absolute_accuracy: Accuracy | None = Field(default=None, description="Of a run.")


class Spread95(Part):
    """Over some places."""

    median: Metres = Field(description="Of the lengths that 95 % of prediction errors stay below.")
    max: Metres = Field(description="The largest of them.")


class PlaceError(Part):
    """One place in the range of the samples."""

    q: list[float] = Field(description="Joints (rad or m).")
    p_base: Vector = Field(description="The reflector in the base.")
    error_95: Metres = Field(description="95 % of the prediction errors stay below this.")


class Workspace95(Spread95):
    """Over joints spread over the ranges of the samples."""

    worst_q: list[float] = Field(description="Joints of the worst place (rad or m).")
    places: list[PlaceError] = Field(description="Every place.")


class Predicted95(Explained):
    """Lengths that 95 % of the prediction errors stay below."""

    samples: Spread95 = Field(description="At the samples.")
    workspace: Workspace95 = Field(description="Over their range.")


class TrackerNoise(Part):
    """Noise of a reading at the middle range."""

    range_m: Metres = Field(description="That range.")
    sigma_axis: Metres = Field(description="Standard deviation along one axis.")
    sigma_3d: Metres = Field(description="RMS distance.")


class ReflectorConstant(Explained):
    """What is open of the reflector's constant."""

    sigma: Metres = Field(description="Standard deviation that is left of it.")
    readings_sigma: Metres = Field(description="What the readings alone leave open.")
    unnoticed: Metres = Field(description="How wrong it may be without showing.")
    unnoticed_error_max: Metres = Field(description="What that does to predictions at most.")


class KincalUncertainty(Part):
    """Of the calibrated arm. The classic method has `cov` null, `meaning` and `tracker` alone."""

    names: list[str] | None = Field(default=None, description="Of the rows of `cov`.")
    cov: Covariance | None = Field(description="Of parameters and registration.")
    cov_meaning: str | None = Field(default=None, description="What its rows are, in words.")
    meaning: str | None = Field(default=None, description="Why there is none.")
    predicted_95: Predicted95 | None = Field(default=None, description="Of predictions.")
    degrees_of_freedom: float | None = Field(
        default=None, description="Of the estimated noise (1); null where the noise is given."
    )
    tracker: TrackerNoise | None = Field(default=None, description="The tracker's own part.")
    reflector_constant: ReflectorConstant | None = Field(default=None, description="Where it is solved for.")


class SampleResidual(Part):
    """One usable sample."""

    index: int = Field(description="Its number in the data set.")
    target: str = Field(description="Its reflector.")
    used: bool = Field(description="Whether the solution used it.")
    e_base: Vector = Field(description="Reading less model, in the base.")
    distance: Metres = Field(description="Length of that.")
    nominal: Metres = Field(description="Distance from the nominal arm in its best place.")
    heldout: Metres | None = Field(description="Distance from an arm that did not see it.")
    range_m: Metres | None = Field(default=None, description="From the tracker.")
    of_chance: float | None = Field(default=None, description="Distance in units of its noise (1).")


class KincalResiduals(Part):
    """How the readings agree with the arm. That is no accuracy."""

    rms: Metres = Field(description="Of the samples that were used.")
    max: Metres = Field(description="The largest of them.")
    rms_nominal: Metres = Field(description="Of the nominal arm, the tracker where it was found.")
    rms_registration_only: Metres = Field(description="Of the nominal arm in its best place.")
    per_sample: list[SampleResidual] = Field(description="Every usable sample.")


class Off(Part):
    """Distances of readings from their prediction."""

    nominal: Metres | None = Field(description="By the nominal arm, the tracker where it was found.")
    registration_only: Metres | None = Field(description="By the nominal arm in its best place.")
    calibrated: Metres | None = Field(description="By the calibrated arm.")


class AsideSample(Off):
    """One reading that was set aside."""

    index: int = Field(description="Its number.")
    target: str = Field(description="Its reflector.")


class SetAside(Explained):
    """Readings that were set aside before solving."""

    samples: int = Field(description="How many.")
    rms: Off = Field(description="RMS distances.")
    max: Off = Field(description="Largest distances.")
    tracker_3d: Metres = Field(description="The tracker's own noise in them, RMS.")
    per_sample: list[AsideSample] = Field(description="Every reading.")


class KincalHeldOut(Explained):
    """Readings judged by an arm that did not see them."""

    folds: int = Field(description="Parts that the samples were divided into.")
    samples: int = Field(description="Samples that were judged.")
    rms: Off = Field(description="RMS distances.")
    max: Off = Field(description="Largest distances.")
    rejected: int | None = Field(default=None, description="Samples that the solution left out.")
    rms_with_rejected: Metres | None = Field(
        default=None, description="RMS distance from the calibrated arm with those counted as well."
    )
    rms_by_region: Metres | None = Field(
        default=None, description="The same with a region of the joints' space left out each time."
    )
    tracker_3d: Metres = Field(description="The tracker's own noise in them, RMS.")
    set_aside: SetAside | None = Field(default=None, description="Of a run.")

    def best(self) -> "KincalHeldOut | SetAside":
        """What judges most severely: poses set aside before solving, where there are any."""
        return self.set_aside or self


class SourceRule(Explained):
    """A rule of thumb for poses."""

    kept: bool = Field(description="Whether the samples keep it.")
    samples: int = Field(description="How many there are.")
    short_steps: int = Field(description="Steps that are too short.")
    smallest_step_rad: float | None = Field(description="The smallest step of a joint (rad).")


class KincalObservability(Part):
    """What the readings determine."""

    parameters: int = Field(description="Unknowns of the arm.")
    rank: int = Field(description="As in `result`.")
    rank_without_registration: int = Field(description="As in `result`.")
    rank_possible: int = Field(description="What any readings could determine.")
    unknowns_with_registration: int = Field(description="`rank` and the tracker's place.")
    condition: float = Field(description="Condition number of what is determined (1).")
    unidentifiable: list[str] = Field(description="As in `result`.")
    unobservable: list[str] = Field(description="What other poses would show.")
    joint_range: list[float] = Field(description="Range of every joint (rad or m).")
    source_rule: SourceRule = Field(description="A rule of thumb for poses.")


class DoubtfulSample(Part):
    """A pose at which the tracker warned."""

    index: int = Field(description="Its number.")
    warnings: list[str] = Field(description="What the tracker said.")


class MonumentMoved(Part):
    """How far one monument was from where the first look saw it."""

    shift_m: Vector = Field(description="In the tracker.")
    moved_m: Metres = Field(description="Its length.")
    sigma_m: Metres = Field(description="Standard deviation along one axis.")


class MonumentLook(Part):
    """One look at the monuments."""

    after: int = Field(description="Samples measured before it.")
    t: Seconds = Field(description="Time of the look.")
    moved: dict[str, MonumentMoved] = Field(description="By name, those that were seen again.")


class Monuments(Explained):
    """Whether the tracker's stand stood."""

    limit_m: Metres = Field(description="How far a monument may move.")
    names: list[str] = Field(description="Those of the first look.")
    looks: list[MonumentLook] = Field(description="Every look.")
    max_moved_m: Metres = Field(description="How far one moved at most.")
    beyond_noise: bool = Field(description="Whether that is more than noise.")
    beyond_limit: bool | None = Field(default=None, description="Whether it is beyond the limit and noise.")
    samples_since_last_look: int = Field(description="Samples after the last look.")


class StoredSet(Part):
    """A stored data set that was solved together with the run's own."""

    path: str = Field(description="Its file.")
    samples: int = Field(description="Its samples.")


class Sampling(Part):
    """How a run measured."""

    arm: str | None = Field(default=None, description="Device.")
    tracker: str | None = Field(default=None, description="Device.")
    serials: dict[str, str | None] | None = Field(default=None, description="Of both.")
    role: str | None = Field(default=None, description="Role of the arm.")
    joint_ranges_rad: Annotated[list[list[float]], Unit("rad")] | None = Field(
        default=None, description="Lowest and highest of each joint, as configured; null without it."
    )
    joints_sampled_rad: Annotated[list[list[float]], Unit("rad")] | None = Field(
        default=None, description="Lowest and highest of each joint at the poses that are solved."
    )
    wanted: int = Field(description="Poses that were planned.")
    measured: int = Field(description="Poses that were measured.")
    set_aside: int = Field(description="Poses that were kept from the solver.")
    off_plan: int | None = Field(default=None, description="Poses measured elsewhere than was asked.")
    doubtful: list[DoubtfulSample] | None = Field(default=None, description="Poses with warnings.")
    lost: list[dict[str, Any]] | None = Field(default=None, description="Poses not measured, and why.")
    T_base_tracker: Pose | None = Field(default=None, description="Where the tracker was first taken to be.")
    predicted: dict[str, Any] | None = Field(default=None, description="What the plan promised (m).")
    stored: StoredSet | None = Field(default=None, description="Solved together with it.")
    reflectors: dict[str, Vector] | None = Field(default=None, description="On the flange.")
    monument_points: dict[str, Any] | None = Field(default=None, description="As first seen (m).")
    monuments: Monuments | None = Field(description="Null when none was looked at.")


class KincalInputs(Inputs):
    """What was solved."""

    method: str = Field(description="Solver.")
    robot: dict[str, Any] = Field(description="The nominal arm as a ROBOT.")
    samples: int = Field(description="In the data set.")
    rotations: int | None = Field(
        default=None, description="Samples with the rotation of a six-degree target: kept, and not used."
    )
    usable: int = Field(description="Those that can be used.")
    used: int = Field(description="Those that the solution used.")
    targets: list[str] = Field(description="Reflectors.")
    noise_given: dict[str, float] = Field(description="As in the data set.")
    payload_kg: Kilograms | None = Field(description="Load of the arm.")
    sampling: Sampling | None = Field(default=None, description="Of a run.")


class KincalResult(Envelope):
    """The kinematics of an arm, measured by a tracker."""

    kind: Literal["kincal"] = "kincal"
    result: KincalAnswer
    uncertainty: KincalUncertainty
    residuals: KincalResiduals
    heldout: KincalHeldOut
    observability: KincalObservability
    inputs: KincalInputs

    def figures(self) -> Figures:
        """RMS on poses set aside, else on those held out in turn; and the 95 % error at the worst place."""
        accuracy = self.result.absolute_accuracy
        after = None if accuracy is None else accuracy.after
        return Figures(
            kinematic_rms_m=after or self.result.rms_calibrated or 0.0,
            predicted_95_m=0.0 if accuracy is None else accuracy.predicted_95,
        )

    def exported(self) -> tuple[str, Any] | None:
        return "kinematics", {"robot": self.result.robot}

    def main_figure(self) -> MainFigure | None:
        forecast = self.uncertainty.predicted_95
        if forecast is None:
            return None
        return MainFigure("predicted_95_m", "95 % error at the worst place", forecast.workspace.max, "m")
