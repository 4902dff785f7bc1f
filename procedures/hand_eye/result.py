"""The result of a hand-eye calibration, field by field."""

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
    Turn,
    Unit,
    Vector,
)
from procedures.hand_eye.result_spread import (
    BaseSpread,
    Distance,
    Estimates,
    LeftOut,
    NeighbourSpread,
    Spread,
    TwoSpreads,
)

Eigenvalues = Annotated[list[float], Unit("rad")]


class NoiseInUse(Part):
    """Standard deviations that the solution was weighted by."""

    sigma_px: Pixels | None = Field(default=None, description="Of a corner, along one axis.")
    sigma_flange_t: Metres | None = Field(default=None, description="Of the flange's place, along one axis.")
    sigma_flange_r: Radians | None = Field(default=None, description="Of its rotation, about one axis.")
    sigma_pose_t: Metres | None = Field(default=None, description="Of a measured pose of the target.")
    sigma_pose_r: Radians | None = Field(default=None, description="Of its rotation.")
    sigma_shared_t: Metres | None = Field(
        default=None,
        description="Without joints: errors of the flange's place that neighbouring poses share, one axis.",
    )
    sigma_shared_r: Radians | None = Field(default=None, description="The same of its rotation.")
    estimated: list[str] = Field(description="Which of them come from the data.")


class Intrinsics(Part):
    """The camera as it was estimated from the images."""

    width: int = Field(description="Of an image (px).")
    height: int = Field(description="Of an image (px).")
    K: list[float] = Field(description="`[fx, fy, cx, cy]` (px).")
    dist: list[float] = Field(description="Distortion in OpenCV's order.")
    sigma_K: list[float] | None = Field(default=None, description="Standard deviations of `K` (px).")
    rms_px: Pixels | None = Field(default=None, description="RMS reprojection.")
    why: str | None = Field(default=None, description="Why the intrinsics were estimated.")


class Unknown(Part):
    """What was found of a number that is never exactly as its model has it."""

    value: float = Field(description="Deviation from the model, in the number's own unit (m, rad, px or 1).")
    sigma: float = Field(description="Its standard deviation.")


class ArmError(Part):
    """How far the flange is from where a model has it, over all joints of the arm."""

    t: Metres = Field(description="RMS of the place.")
    r: Radians = Field(description="RMS of the rotation.")
    t95: Metres = Field(description="95 % of the errors of the place over the joints are below this.")


class ArmFromBoard(Part):
    """The arm's accuracy as the board tells it; a shift of base or flange as a whole is left out."""

    configured: ArmError = Field(description="By the model in use.")
    corrected: ArmError = Field(description="With all that was found taken off.")


class BudgetPart(Part):
    """Standard uncertainty of the camera's pose by one cause; squares add up to that of the pose."""

    block: str = Field(description="`arm`, `lens`, `target` or `noise`.")
    t: Metres = Field(description="Of the place.")
    r: Radians = Field(description="Of the rotation.")


class TargetScale(Part):
    """How much larger the target is than stated, as a share: 0.002 is 0.2 % too large."""

    x: float = Field(description="Along its x (1).")
    y: float = Field(description="Along its y (1).")
    sigma_x: float = Field(description="Standard deviation (1).")
    sigma_y: float = Field(description="Standard deviation (1).")


class OnCorrectedArm(Part):
    """The camera's pose for the flange, or base, of the corrected arm `robot`: to be used with that arm."""

    T_flange_camera: Pose | None = Field(default=None, description="Eye-in-hand.")
    T_base_camera: Pose | None = Field(default=None, description="Eye-to-hand.")
    cov: Covariance = Field(description="In the axes of the camera.")


class AbsoluteAccuracy(Part):
    """Position of the flange at the joints asked for, else the capture's, after the best base and tool."""

    before: Metres = Field(description="RMS distance of the arm as configured from the corrected one.")
    after: Metres = Field(description="RMS error that is expected to remain.")
    predicted_95: Metres = Field(description="95 % of the errors that remain stay below this.")


class AtTask(Part):
    """A point that the camera locates at the task's place (eye-to-hand: the flange there): how far off."""

    configured95: Metres = Field(description="95 % of the errors are below this, by the arm as configured.")
    corrected95: Metres = Field(description="The same with the corrected arm and the camera's pose on it.")
    clearance_m: Metres | None = Field(default=None, description="Of a run: what the task leaves free.")
    grade: Literal["pass", "warn", "fail"] | None = Field(
        default=None,
        description="Of a run: `pass` where the configured arm is within the clearance, `warn` where only "
        "the corrected one is, `fail` where neither is.",
    )


class HandEyeAnswer(Part):
    """Where the camera is, and what that rests on."""

    T_flange_camera: Pose | None = Field(default=None, description="Eye-in-hand: the camera in the flange.")
    T_base_camera: Pose | None = Field(default=None, description="Eye-to-hand: the camera in the base.")
    direction: str = Field(description="The same in words.")
    T_base_target: dict[str, Pose] | None = Field(
        default=None, description="Eye-in-hand: the target in the base, by placement."
    )
    T_flange_target: dict[str, Pose] | None = Field(
        default=None, description="Eye-to-hand: the target in the flange, by placement."
    )
    cov: Covariance | None = Field(description="Of the camera's pose, in the axes of the camera.")
    rejected: list[Rejected] = Field(description="Every observation that was not used.")
    spread_within: Spread | None = Field(description="Of the estimates within placements.")
    spread_across: Spread | None = Field(description="Of the estimates of several placements.")
    spread_by_base: dict[str, BaseSpread] | None = Field(
        default=None, description="The two by place of the target's stand; null where it is not told."
    )
    neighbour_spread: NeighbourSpread | None = Field(
        default=None, description="The same two by the classic cone method, unweighted."
    )
    as_configured: TwoSpreads | None = Field(
        default=None,
        description="With method `adjustment`: both without what was found of arm, lens and target.",
    )
    estimates: dict[str, Estimates] = Field(description="Of simple solvers, by placement.")
    noise: NoiseInUse = Field(description="Noise levels in use.")
    intrinsics: Intrinsics | None = Field(default=None, description="Only when they were estimated.")
    unknowns: dict[str, dict[str, Unknown]] | None = Field(
        default=None,
        description="With method `adjustment`: what was found of arm, lens and target, by block.",
    )
    scale: dict[str, float] | None = Field(
        default=None, description="With method `adjustment`: how good the arm is, in units of its prior (1)."
    )
    arm: ArmFromBoard | None = Field(
        default=None, description="With method `adjustment`, robot and joints: the arm's accuracy."
    )
    budget: list[BudgetPart] | None = Field(
        default=None, description="With method `adjustment`: the uncertainty of the pose by cause."
    )
    target_scale: TargetScale | None = Field(
        default=None, description="With method `adjustment`: the printed size that was found."
    )
    lens: Intrinsics | None = Field(
        default=None, description="With method `adjustment`: the lens that belongs to the pose."
    )
    lens_cov: list[list[float]] | None = Field(
        default=None,
        description="With `lens`: 14x14, `cov` and that of the lens's `unknowns` in their order, as they go "
        "together.",
    )
    robot: dict[str, Any] | None = Field(
        default=None, description="With method `adjustment`, robot and joints: ROBOT of the corrected arm."
    )
    adjusted: OnCorrectedArm | None = Field(
        default=None, description="With `robot`: the camera's pose on the corrected arm."
    )
    absolute_accuracy: AbsoluteAccuracy | None = Field(
        default=None, description="With `robot`: how far off the arm is, and what is left with `robot`."
    )
    task: AtTask | None = Field(
        default=None, description="With `robot` and the data set's `task`: accuracy where it is needed."
    )
    T_base_flange: list[Pose] | None = Field(
        default=None, description="With `--predict`: where the flange is at those joints."
    )
    p_cov: list[list[list[float]]] | None = Field(
        default=None, description="With `--predict`: covariance of each place (m2), best base and tool off."
    )

    def pose(self) -> tuple[str, list[float]] | None:
        """Name and pose6 of the camera; None for an answer that holds neither."""
        found = {"T_flange_camera": self.T_flange_camera, "T_base_camera": self.T_base_camera}
        return next(((name, pose) for name, pose in found.items() if pose is not None), None)

    def targets(self) -> dict[str, list[float]]:
        """pose6 of the target by placement: in the base, or in the flange."""
        return self.T_base_target or self.T_flange_target or {}


class LeavingOut(Part):
    """The stated covariance against the jackknife; beyond the limit it was enlarged to it."""

    ratio: float = Field(
        description="Largest standard deviation by leaving out over the stated one, in any direction."
    )
    limit: float = Field(description="The ratio that chance explains with so many observations.")


class HandEyeUncertainty(Explained):
    """Of the answer. Without a covariance only `meaning` is there."""

    cov: Covariance | None = Field(default=None, description="As in `result`.")
    sigma_t: Vector | None = Field(default=None, description="Standard deviations of the camera's place.")
    sigma_r: Turn | None = Field(default=None, description="Standard deviations of its rotation.")
    sigma_t_norm: Metres | None = Field(default=None, description="Length of `sigma_t`.")
    sigma_r_norm: Radians | None = Field(default=None, description="Length of `sigma_r`.")
    cov_targets: dict[str, Covariance] | None = Field(
        default=None, description="Of the target's pose, by placement."
    )
    excess: float | None = Field(
        default=None, description="Factor of the covariance, as the residuals exceed the noise."
    )
    priors: dict[str, str] | None = Field(
        default=None, description="With method `adjustment`: how well each part was known, and by what."
    )
    covers: list[str] | None = Field(
        default=None, description="With method `adjustment`: what it covers beside noise. Else noise alone."
    )
    leaving_out: LeavingOut | None = Field(
        default=None, description="With method `adjustment`: the check by leaving out observations."
    )
    error95_t_m: Metres | None = Field(
        default=None, description="Of a run: 95 % of the errors of the place stay below this."
    )
    error95_r_rad: Radians | None = Field(
        default=None, description="Of a run: 95 % of the errors of the rotation stay below this."
    )


class ObservationResidual(Part):
    """One usable observation."""

    index: int = Field(description="Its number in the data set.")
    group: int = Field(description="Its placement.")
    used: bool = Field(description="Whether the solution used it.")
    t: Metres = Field(description="Distance of its target's pose from the mean.")
    r: Radians = Field(description="Angle from the mean.")
    reprojection_px: Pixels | None = Field(description="RMS, the image with a pose of its own.")
    through_arm_px: Pixels | None = Field(description="RMS, with the pose that arm and answer predict.")
    corners: int | None = Field(description="How many corners it shows.")
    distance: float | None = Field(description="Distance from the solution in units of its noise (1).")


class CrossCheck(Part):
    """The answer of one of OpenCV's solvers."""

    pose: Pose = Field(description="Of the camera.")
    from_ours: Distance = Field(description="Distance from the answer.")
    spread_mean: Distance = Field(description="Mean distance of the target's poses from their mean.")


class HandEyeResiduals(Part):
    """How well the data agree with each other. That is no accuracy."""

    spread_mean_all: Distance = Field(
        description="Mean distance of the target's poses from their mean, of all usable observations."
    )
    spread_mean: Distance = Field(description="The same, of those used.")
    loo_mean: LeftOut = Field(
        description="The same, each judged by a camera's pose from the others; see heldout.from_all."
    )
    reprojection_rms_px: Pixels | None = Field(description="Each image with a pose of its own.")
    reprojection_through_arm_rms_px: Pixels | None = Field(
        default=None, description="With the poses that arm and answer predict."
    )
    per_observation: list[ObservationResidual] = Field(description="Every usable observation.")
    cross_check: dict[str, CrossCheck | None] = Field(description="Other solvers on the same poses, by name.")


class HandEyeHeldOut(Explained):
    """The target's pose by observations that the camera's pose was not found from."""

    folds: int = Field(description="Parts that the observations were divided into.")
    from_all: list[str] | None = Field(
        default=None,
        description="What was found from all observations and held: of the arm, the lens and the target.",
    )
    observations: int = Field(description="Observations that were judged.")
    mean: LeftOut = Field(description="Mean distance.")
    rms: LeftOut = Field(description="RMS distance.")
    rejected: int | None = Field(default=None, description="Usable observations that were left out.")
    rms_with_rejected: LeftOut | None = Field(default=None, description="RMS with those counted as well.")
    rms_by_placement: LeftOut | None = Field(
        default=None, description="RMS, each placement judged by the others; empty with one placement."
    )


class HandEyeObservability(Part):
    """How far the arm turned, and what is known least."""

    rotation_rms_rad: Eigenvalues = Field(description="How far the arm turned, about three axes.")
    rotation_axes: list[list[float]] = Field(description="Those axes (1).")
    axes_frame: str = Field(description="Frame of the axes.")
    unobservable: list[str] = Field(description="What is not determined.")
    weakest: str = Field(description="What is known least, in words.")
    ambiguity: str | None = Field(description="What a symmetry of the target leaves open.")


class MovedCamera(Part):
    """How far the camera is from where the version in effect before this run has it."""

    version: int = Field(description="Of the calibration.")
    t: Metres = Field(description="Of the place.")
    r: Radians = Field(description="Of the rotation.")
    beyond_uncertainty: bool = Field(description="Whether it is more than two such results differ by chance.")
    false_alarm: float | None = Field(
        default=None, description="Chance to be called so where the camera has not moved (1)."
    )


class HandEyeInputs(Inputs):
    """What was solved."""

    setup: Literal["eye-in-hand", "eye-to-hand"] = Field(description="Where the camera is.")
    method: str = Field(description="Solver.")
    observations: int = Field(description="Observations in the data set.")
    usable: int = Field(description="Those that show the target.")
    used: int = Field(description="Those that the solution used.")
    groups: int = Field(description="Placements.")
    target: dict[str, Any] = Field(description="As in the data set.")
    noise_given: dict[str, float] = Field(description="As in the data set.")
    moved: MovedCamera | None = Field(default=None, description="Of a run; against the version in effect.")


class HandEyeResult(Envelope):
    """The pose of a camera on the flange, or beside the arm."""

    kind: Literal["hand-eye"] = "hand-eye"
    result: HandEyeAnswer
    uncertainty: HandEyeUncertainty
    residuals: HandEyeResiduals
    heldout: HandEyeHeldOut
    observability: HandEyeObservability
    inputs: HandEyeInputs

    def figures(self) -> Figures:
        """The two spreads, and the length that 95 % of the errors stay below."""
        within, across = self.result.spread_within, self.result.spread_across
        return Figures(
            spread_within_m=0.0 if within is None else within.t_norm,
            spread_across_m=0.0 if across is None else across.t_norm,
            predicted_95_m=self.uncertainty.error95_t_m or 0.0,
        )

    def exported(self) -> tuple[str, Any] | None:
        return self.result.pose()

    def main_figure(self) -> MainFigure | None:
        found = self.uncertainty.error95_t_m
        return None if found is None else MainFigure("error95_t_m", "95 % error of the place", found, "m")
