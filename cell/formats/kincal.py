"""``cellward.kincal/1``: joints of an arm and where a laser tracker saw reflectors on its flange.

Five extensions of the format that runs use: a sample may have its own ``index``, its time ``t``, and
``scatter_m``, the spread of the readings that were averaged, and a ``rotation``; ``noise`` may have
``sigma_constant``.
``p_tracker`` may be null: the beam was broken. ``rotation`` is the rotation vector (rad) of a six-degree
target in the tracker frame, and beside angles in the axes of who sent it; it is kept and not used.
"""

from typing import Annotated, Any

from pydantic import Field, model_validator

from cell.formats.bounds import (
    QUERIES,
    SAMPLES,
    Joints,
    Length,
    LengthOrAngle,
    Payload,
    Rotation,
    SigmaLength,
    SigmaPerMetre,
    Stamp,
    Whole,
)
from cell.formats.reading import Strict

SCHEMA = "cellward.kincal/1"
QUERY_SCHEMA = "cellward.kincal-query/1"
TARGETS_SCHEMA = "cellward.kincal-targets/1"


class TrackerNoiseTable(Strict):
    """Standard deviation along one axis: ``sigma0`` (m) plus ``sigma_per_m`` times the range."""

    sigma0: SigmaLength | None = None
    sigma_per_m: SigmaPerMetre | None = None

    @model_validator(mode="after")
    def _slope_has_a_start(self) -> "TrackerNoiseTable":
        if self.sigma_per_m is not None and self.sigma0 is None:
            raise ValueError("(noise) has sigma_per_m without sigma0; give both, or leave noise out")
        return self


class KincalNoise(TrackerNoiseTable):
    """``sigma_constant`` (m): how well a reflector's constant is known; without it, it is taken as right."""

    sigma_constant: SigmaLength | None = None


class KincalSample(Strict):
    """One pose at rest. ``p_tracker`` is in the tracker frame, m; ``target`` names the reflector."""

    q: Joints
    p_tracker: Annotated[list[Length | None], Field(min_length=3, max_length=3)] | None
    target: str | None = None
    index: Whole | None = None
    t: Stamp | None = None
    scatter_m: Length | None = None
    rotation: Rotation | None = None
    notes: Any = None


class Kincal(Strict):
    """The whole data set."""

    schema_: Annotated[str, Field(alias="schema")]
    robot: dict[str, Any] | None = None
    noise: KincalNoise | None = None
    payload_kg: Payload | None = None
    samples: Annotated[list[KincalSample], Field(max_length=SAMPLES)]
    notes: Any = None


class KincalQuery(Strict):
    """Joints for which the tracker's reading is wanted."""

    schema_: Annotated[str, Field(alias="schema")]
    q: Annotated[list[Joints], Field(max_length=QUERIES)]
    target: str | None = None
    notes: Any = None


class KincalTargets(Strict):
    """Wanted flange poses in the base, or x, y, z, yaw of a palletizer; ``q_near`` picks the branch."""

    schema_: Annotated[str, Field(alias="schema")]
    targets: Annotated[
        list[Annotated[list[LengthOrAngle], Field(min_length=4, max_length=6)]], Field(max_length=QUERIES)
    ]
    q_near: list[Joints] | None = None
    notes: Any = None

    @model_validator(mode="after")
    def _lengths_fit(self) -> "KincalTargets":
        for k, target in enumerate(self.targets):
            if len(target) == 5:
                raise ValueError(f"(targets[{k}]) has 5 numbers; give x, y, z, rx, ry, rz or x, y, z, yaw")
        if self.q_near is not None and len(self.q_near) != len(self.targets):
            raise ValueError(
                f"(q_near) has {len(self.q_near)} entries for {len(self.targets)} targets; give one for each"
            )
        return self
