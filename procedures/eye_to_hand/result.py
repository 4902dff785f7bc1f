"""The result of an eye-to-hand check, field by field."""

from typing import Annotated, Any, Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import (
    Covariance,
    Envelope,
    Explained,
    Figures,
    Inputs,
    Metres,
    Part,
    Pixels,
    Pose,
    Radians,
    Rejected,
    Unit,
    Vector,
)

JointsRead = Annotated[list[float], Unit("rad")]


class PoseSize(Part):
    """The size of a motion, or its standard deviation."""

    t: Metres = Field(description="Of the place.")
    r: Radians = Field(description="Of the rotation.")


class PlaceOff(PoseSize):
    """The target's place on the flange against the given one."""

    xi: list[float] = Field(description="The motion, perturbation of `T_marker_flange` on the right.")
    cov: Covariance = Field(description="Of that motion, from the images and the arm alone.")
    T_marker_flange: Pose = Field(description="The place as the images have it.")


class Suspicion(Part):
    """Squared Mahalanobis distances of what was given from what the images say (1)."""

    X: float = Field(description="Of the hand-eye, whatever the target's place; 6 degrees of freedom.")
    C: float = Field(description="Of the target's place, whatever the hand-eye; 6 degrees of freedom.")
    both: float = Field(description="Of both together; 12 degrees of freedom.")


class Positioning(Part):
    """The flange through the given hand-eye against the flange as the arm reports it."""

    t_rms: Metres = Field(description="RMS of the place.")
    r_rms: Radians = Field(description="RMS of the rotation.")


class MappedPose(Part):
    """One pose of the map of the workspace."""

    index: int = Field(description="Its number in the data set.")
    p: Vector = Field(description="Where the flange was, as reported, in the base.")
    d: Vector = Field(description="By how much the camera sees it elsewhere, in the base.")
    r: Radians = Field(description="Angle between the two.")


class TargetCorrection(Part):
    """How targets are best corrected, by observations that were not looked at."""

    chosen: Literal["none", "constant", "model"] = Field(
        description="`none`: as given; `constant`: by the plain mean, with the place found where the given "
        "one is blamed or in doubt; `model`: the arm with its errors."
    )
    cv_none: Metres = Field(description="RMS distance of the target from where the given hand-eye has it.")
    cv_constant: Metres = Field(description="The same with the constant correction.")
    cv_model: Metres | None = Field(default=None, description="The same through the arm's model.")
    shift: Pose | None = Field(
        default=None,
        description="The constant as a motion of the base: `shift` times a `T_base_flange` as given is the "
        "corrected one. Null in results that were made before it was told.",
    )
    T_base_camera: Pose | None = Field(
        default=None,
        description="The constant as a hand-eye: `shift` times the given one. For targets alone; the camera "
        "itself is where `T_camera_base` of the result says.",
    )

    def by_way(self) -> dict[str, float | None]:
        """The three figures by the name of the way."""
        return {"none": self.cv_none, "constant": self.cv_constant, "model": self.cv_model}


class NoiseFound(Part):
    """Standard deviations that the plain solution was weighted by."""

    sigma_px: Pixels | None = Field(default=None, description="Of a corner, along one axis.")
    sigma_flange_t: Metres | None = Field(default=None, description="Of the flange's place.")
    sigma_flange_r: Radians | None = Field(default=None, description="Of its rotation.")
    sigma_pose_t: Metres | None = Field(default=None, description="Of a measured pose of the target.")
    sigma_pose_r: Radians | None = Field(default=None, description="Of its rotation.")
    estimated: list[str] = Field(description="Which of them come from the data.")


class OnCorrectedArm(Part):
    """The standard for the base of the corrected arm `robot`: to be used with that arm."""

    T_camera_base: Pose = Field(description="The base in the camera.")
    cov: Covariance = Field(description="Of it, perturbation on the right.")


class SeenAtTarget(Part):
    """One rest at a target, through the camera."""

    q: JointsRead | None = Field(description="Joints at which the arm rested.")
    off_m: Metres = Field(description="How far the target on the flange was from where it was wanted.")
    off: Vector = Field(description="As a vector in the camera: where it was less where it should be.")
    off_95_m: Metres = Field(
        description="95 % of the errors of `off` stay below this, `common_95_m` included; an error of a lens "
        "that is taken as it is given is not in it."
    )
    common_95_m: Metres = Field(
        description="Of it what is common to all targets: lens where it is not taken as given, print, and "
        "the target's place on the flange."
    )


class DrivenTarget(Part):
    """One target that the arm was driven to, as given and corrected."""

    number: int = Field(description="From 1, in the order of the configuration.")
    T_camera_flange: Pose = Field(description="The flange as wanted.")
    given: Pose = Field(description="`T_base_flange` through the given hand-eye.")
    corrected: Pose | None = Field(description="`T_base_flange` that is commanded instead; null without one.")
    before: SeenAtTarget | None = Field(description="Driven as given; null where it was not measured.")
    after: SeenAtTarget | None = Field(description="Driven corrected; null where it was not measured.")


class DrivenTargets(Part):
    """What was off at targets that the answer was not made of."""

    way: Literal["none", "constant", "model"] = Field(description="What they were corrected by.")
    targets: list[DrivenTarget] = Field(description="Every target.")
    before_rms_m: Metres | None = Field(
        default=None, description="RMS as given, over those measured in both ways."
    )
    after_rms_m: Metres | None = Field(default=None, description="The same corrected.")
    better: bool | None = Field(
        default=None,
        description="Corrected is surely nearer than as given: squared distances are less by more than twice "
        "their standard deviation, common errors and how well the arm repeats a pose included, a lens that "
        "is taken as given not; null where nothing was measured in both ways.",
    )
    meaning: str = Field(description="What the figures cover, and what they do not.")
    lost: list[str] = Field(description="What was not measured, in words.")
    stands: str | None = Field(
        default=None, description="Where the arm was left, and why, where it did not go back."
    )


class AxbcAnswer(Part):
    """Where the base is in the camera, and what was given of it judged."""

    T_camera_base: Pose = Field(
        description="The standard: images, arm and, where nothing speaks against it, the known place. "
        "For the base that serves the arm as configured best."
    )
    direction: str = Field(description="The same in words.")
    cov: Covariance = Field(description="Of `T_camera_base`, perturbation on the right.")
    mean: Pose = Field(
        description="The standard of the published method: plain mean of `A^-1 C B^-1`, with C as given also "
        "where it is blamed or in doubt. Figures of ways and positioning go by the place that was found then."
    )
    eval: PoseSize = Field(description="The given hand-eye against the standard.")
    eval_sigma: PoseSize = Field(description="How well the standard knows that.")
    C_offset: PlaceOff = Field(description="The target's place against the given one.")
    blamed: Literal["none", "X", "C", "arm", "cannot-tell"] = Field(
        description="What does not fit the images: the given hand-eye (`X`), the given place (`C`), the arm."
    )
    suspicion: Suspicion = Field(description="What that rests on.")
    positioning: Positioning = Field(
        description="Positioning accuracy through the given hand-eye and the target's place, as given or, "
        "where that is blamed or in doubt, as found."
    )
    places: list[MappedPose] = Field(description="The same pose by pose.")
    correction: TargetCorrection = Field(description="Correction of targets.")
    robot: dict[str, Any] | None = Field(
        default=None, description="ROBOT of the arm with its errors, when the data have joints and a robot."
    )
    adjusted: OnCorrectedArm | None = Field(
        default=None, description="With `robot`: the standard for the base of that arm."
    )
    scale: dict[str, float] = Field(
        description="How large the arm's errors are, in units of their prior (1)."
    )
    noise: NoiseFound = Field(description="Noise levels in use.")
    rejected: list[Rejected] = Field(description="Every observation that was not used.")
    commands: list[Pose | None] | None = Field(
        default=None, description="With `--targets`: `T_base_flange` to command; null where out of reach."
    )
    driven: DrivenTargets | None = Field(
        default=None, description="With `targets` of the job: each was driven to, and seen."
    )


class AxbcUncertainty(Explained):
    """Of the standard."""

    cov: Covariance = Field(description="As in `result`.")
    priors: dict[str, str] = Field(description="How well each part was known, and by what.")


class AxbcResiduals(Explained):
    """How well the data agree with each other. That is no accuracy."""

    distance_rms: float = Field(description="RMS distance from the plain solution in units of its noise (1).")
    excess: float = Field(description="Factor of the plain covariance, as residuals exceed the noise (1).")


class AxbcHeldOut(Explained):
    """The target's place by observations that were not looked at."""

    folds: int = Field(description="Parts that the observations were divided into.")
    observations: int = Field(description="Observations that were judged.")
    rms_none: Metres = Field(description="With the given hand-eye.")
    rms_constant: Metres = Field(description="With the constant correction.")
    rms_model: Metres | None = Field(default=None, description="Through the arm's model.")


class AxbcInputs(Inputs):
    """What was solved."""

    observations: int = Field(description="Observations in the data set.")
    usable: int = Field(description="Those that show the target.")
    used: int = Field(description="Those that the answer was made of.")


class AxbcResult(Envelope):
    """Of an AXB = C data set."""

    result: AxbcAnswer
    uncertainty: AxbcUncertainty
    residuals: AxbcResiduals
    heldout: AxbcHeldOut
    observability: dict[str, Any] = Field(default_factory=dict, description="Empty where there is an answer.")
    inputs: AxbcInputs

    def figures(self) -> Figures:
        correction = self.result.correction
        return Figures(kinematic_rms_m=correction.by_way()[correction.chosen] or 0.0)

    def main_figure(self) -> MainFigure:
        half = 1.96 * self.result.eval_sigma.t  # standard deviations to 95 % of a normal distribution
        return MainFigure("eval_t_m", "camera off its place", self.result.eval.t, "m", half)
