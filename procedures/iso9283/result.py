"""The result of a test of pose accuracy and repeatability, field by field."""

from typing import Annotated, Final, Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import (
    Envelope,
    Explained,
    Inputs,
    Interval,
    Kilograms,
    Metres,
    Part,
    Pose,
    Unit,
    Vector,
)

Figure = Literal["AP", "RP"]
KEYS: Final[tuple[Figure, Figure]] = ("AP", "RP")


class PoseResult(Part):
    """One of the five poses. AP and RP are never given below the tracker's own."""

    name: str = Field(description="`P1` to `P5`.")
    commanded: Vector = Field(description="Where the reflector was wanted, in the base.")
    barycentre: Vector = Field(description="Mean of where it was, in the base.")
    deviation: Vector = Field(description="Barycentre less the place commanded.")
    AP: Metres = Field(description="Pose accuracy.")
    AP_measured: Metres = Field(description="Pose accuracy as it was measured.")
    AP_U: Metres = Field(description="95 % of the errors of the barycentre stay below this.")
    AP_tracker: Metres = Field(description="AP that a perfect arm would show in 95 % of tests.")
    AP_resolved: bool = Field(description="Whether AP stands out from the tracker's own.")
    RP: Metres = Field(description="Pose repeatability.")
    RP_measured: Metres = Field(description="Pose repeatability as it was measured.")
    RP_95: Annotated[Interval, Unit("m")] | None = Field(
        description="95 % interval of RP; null with too few arrivals."
    )
    RP_tracker: Metres = Field(description="RP that a perfect arm would show.")
    RP_resolved: bool = Field(description="Whether RP stands out from the tracker's own.")
    mean_distance: Metres = Field(description="Mean distance of the arrivals from their barycentre.")
    std_distance: Metres = Field(description="Its standard deviation.")
    cycles: int = Field(description="Arrivals that were measured.")

    def figure(self, key: Figure) -> tuple[float, float, bool]:
        """AP or RP (m), as it was measured (m), and whether it is resolved."""
        if key == "AP":
            return self.AP, self.AP_measured, self.AP_resolved
        return self.RP, self.RP_measured, self.RP_resolved


class Formula(Part):
    """How AP and RP are computed."""

    AP: str = Field(description="Of AP.")
    RP: str = Field(description="Of RP.")
    floor: str = Field(description="What bounds both from below.")


class TrackerNoise(Explained):
    """What the tracker alone would show of a perfect arm; averaging is given no credit."""

    sigma0: Metres | None = Field(description="Constant part of the standard deviation of a reading.")
    sigma_per_m: float | None = Field(description="Its part for each metre of range (m/m).")
    sigma_axis_m: Metres = Field(description="Along one axis, at the pose that is farthest.")
    AP_95_m: Metres = Field(description="95 % of AP stay below this.")
    RP_m: Metres = Field(description="RP.")


class RegistrationUsed(Explained):
    """Where the tracker was taken to stand."""

    how: Literal["fit", "kinematics"] = Field(
        description="`fit`: fitted to these poses; `kinematics`: from the calibration."
    )
    poses: int = Field(description="Poses with arrivals.")
    T_base_tracker: Pose = Field(description="Pose of the tracker in the base.")
    rms_m: Metres = Field(description="RMS distance of the barycentres from where they were wanted.")
    rms_best_m: Metres = Field(description="The same with the place of the tracker that suits them best.")


class Drift(Explained):
    """How far all poses moved together from the first third of the cycles to the last."""

    shift_m: Vector = Field(description="In the base.")
    distance_m: Metres = Field(description="Its length.")
    sigma_m: Metres = Field(description="Standard deviation of the shift along one axis.")
    beyond_noise: bool = Field(description="Whether it is more than noise explains.")


class Iso9283Answer(Part):
    """Accuracy and repeatability of the five poses."""

    AP: dict[str, Metres] = Field(description="AP by pose.")
    RP: dict[str, Metres] = Field(description="RP by pose.")
    AP_max: Metres = Field(description="AP of the worst pose.")
    RP_max: Metres = Field(description="RP of the worst pose.")
    poses: list[PoseResult] = Field(description="Every pose.")
    formula: Formula = Field(description="How AP and RP are computed.")
    tracker: TrackerNoise = Field(description="The tracker's own part.")
    corrected: bool = Field(description="Whether the arm was commanded through its calibrated kinematics.")
    kinematics_version: int | None = Field(description="Version of those kinematics.")
    registration: RegistrationUsed = Field(description="The tracker's place.")
    cycles: int = Field(description="Arrivals at the pose that has the fewest.")
    cycles_wanted: int = Field(description="Cycles that were asked for.")
    reflector: str = Field(description="Name of the reflector.")
    point: Vector = Field(description="The reflector in the flange.")
    speed_share: float = Field(description="Share of the cell's limits of speed (1).")
    payload_kg: Kilograms = Field(description="Load of the arm.")
    drift: Drift | None = Field(description="Of all poses together; null with fewer than six cycles.")


class Iso9283Uncertainty(Explained):
    """Of the figures, by pose."""

    AP_U: dict[str, Metres] = Field(description="95 % of the errors of a barycentre stay below this.")
    RP_95: dict[str, Annotated[Interval, Unit("m")] | None] = Field(description="95 % intervals of RP.")


class Arrival(Part):
    """One arrival."""

    pose: str = Field(description="`P1` to `P5`; `R1` and so on only locate the tracker.")
    cycle: int = Field(description="Its cycle, from 1; 0 for a pose that only locates.")
    off: Vector = Field(description="Its place less the barycentre of its pose, in the base.")


class Iso9283Residuals(Part):
    """How the arrivals scatter."""

    per_sample: list[Arrival] = Field(description="Every arrival.")


class Iso9283HeldOut(Explained):
    """Nothing is held out."""


class Iso9283Observability(Part):
    """What is open."""

    undetermined: list[str] = Field(description="What the test cannot show, in words.")


class Iso9283Inputs(Inputs):
    """What was measured."""

    robot_joints: int = Field(description="Joints of the arm.")
    samples: int = Field(description="Arrivals in the data set.")
    rotations: int | None = Field(
        default=None, description="Arrivals with the rotation of a six-degree target: kept, and not used."
    )
    corrected: bool = Field(description="As in `result`.")
    payload_kg: Kilograms = Field(description="Load of the arm.")


class Iso9283Result(Envelope):
    """Pose accuracy and repeatability in the manner of ISO 9283."""

    kind: Literal["iso9283"] = "iso9283"
    result: Iso9283Answer
    uncertainty: Iso9283Uncertainty
    residuals: Iso9283Residuals
    heldout: Iso9283HeldOut
    observability: Iso9283Observability
    inputs: Iso9283Inputs

    def main_figure(self) -> MainFigure:
        worst = max(self.result.AP, key=self.result.AP.__getitem__)
        half = self.uncertainty.AP_U[worst]
        return MainFigure("AP_max_m", "pose accuracy AP, worst pose", self.result.AP_max, "m", half)
