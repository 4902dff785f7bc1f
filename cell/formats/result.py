"""``cellward.result/1``: what every solver answers with, and the parts that the kinds of results share.

A result is read as the model of its kind. What the model has is required where every stored result has it;
keys that it does not know are kept, so that a result of a later version can be read. A result without an
answer is read as a plain ``Result`` whatever its kind.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from cell.errors import error
from cell.formats.main_figure import MainFigure
from cell.formats.reading import path_in
from cell.version import software

SCHEMA = "cellward.result/1"

Verdict = Literal["pass", "warn", "fail"]


@dataclass(frozen=True)
class Unit:
    """Of a figure, in the annotation of its field; the manual shows it."""

    symbol: str


Metres = Annotated[float, Unit("m")]
MetresPerSecond = Annotated[float, Unit("m/s")]
Radians = Annotated[float, Unit("rad")]
Seconds = Annotated[float, Unit("s")]
Pixels = Annotated[float, Unit("px")]
Kilograms = Annotated[float, Unit("kg")]
Vector = Annotated[list[float], Field(min_length=3, max_length=3), Unit("m")]
Turn = Annotated[list[float], Field(min_length=3, max_length=3), Unit("rad")]
Pose = Annotated[list[float], Field(min_length=6, max_length=6), Unit("m, rad")]
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
Covariance = list[list[float]]
M = TypeVar("M", bound="Envelope")


class Part(BaseModel):
    """A table of a result. It dumps as it was read: what is absent and None stays absent."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)

    @model_serializer(mode="wrap")
    def _as_stored(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        found: dict[str, Any] = dump(self)
        return {k: v for k, v in found.items() if v is not None or k in self.model_fields_set}

    def changed(self, **fields: Any) -> Self:
        """A copy with other values in these fields; ``TypeError`` for a name that is no field."""
        if unknown := fields.keys() - type(self).model_fields.keys():
            raise TypeError(f"{type(self).__name__} has no field {', '.join(sorted(unknown))}")
        return self.model_copy(update=fields)


class Empty(Part):
    """A table without figures."""

    model_config = ConfigDict(extra="forbid")


class Explained(Part):
    """A table that says in words what it holds."""

    meaning: str = Field(description="What the figures mean, in words.")


class Rejected(Part):
    """An entry of a data set that was not used."""

    index: int = Field(description="Its number in the data set.")
    reason: str = Field(description="Why it was not used.")


class Warning_(Part):
    """A finding that does not stop the solver."""

    code: str = Field(description="Fixed name.")
    text: str = Field(description="The finding in words.")

    @classmethod
    def each(cls, found: Iterable[tuple[str, str]]) -> list[Self]:
        """Of pairs of code and text."""
        return [cls(code=code, text=text) for code, text in found]


class ModelInUse(Part):
    """Which model of the arm a run worked with."""

    name: str = Field(description="`controller`, or the calibration of the kinematics.")
    version: int | None = Field(default=None, description="Of that calibration.")


class StepTakenAgain(Part):
    """A step that the run took again after a short silence of a device."""

    step: str = Field(description="What was being done.")
    cause: str = Field(description="Code of what interrupted it.")
    why: str = Field(description="What interrupted it, in words.")
    after_s: Seconds = Field(description="Time from the beginning of the step to the interruption.")
    lost_s: Seconds = Field(description="Time that it cost.")


class Inputs(Part):
    """What a result was made from, in what the kinds share."""

    solve_seconds: Seconds | None = Field(default=None, description="Wall time of the solver alone.")
    arm_model: ModelInUse | None = Field(
        default=None,
        description="Model of the arm that the run worked with, or of `solve --kinematics`.",
    )
    steps_taken_again: list[StepTakenAgain] | None = Field(
        default=None, description="Steps that short silences of devices interrupted."
    )
    trend: dict[str, Any] | None = Field(
        default=None, description="Figures that a trend follows from run to run."
    )


@dataclass(frozen=True)
class Figures:
    """What the registers of a PLC and the status bits show of a result; 0 for what its kind does not have."""

    spread_within_m: float = 0.0
    spread_across_m: float = 0.0
    tool_offset_m: Sequence[float] = (0.0, 0.0, 0.0)
    tool_tilt_rad: float = 0.0
    kinematic_rms_m: float = 0.0
    predicted_95_m: float = 0.0
    tool_moved: bool = False
    stands: bool = True  # there is an answer, and what was to be put into effect is


NO_FIGURES = Figures(stands=False)


class Envelope(Part):
    """What every result begins with. A kind adds its own ``result``, ``uncertainty`` and so on."""

    schema_: Annotated[str, Field(alias="schema", description=f"`{SCHEMA}`.")] = SCHEMA
    kind: str = Field(description="Kind of the result.")
    verdict: Verdict = Field(description="`pass`, `warn` or `fail`.")
    reasons: list[str] = Field(default_factory=list, description="Why the verdict is not `pass`, in words.")
    warnings: list[Warning_] = Field(default_factory=list, description="Findings with fixed codes.")
    software: str | None = Field(
        default=None, description="Program and version that made it; null where nothing says so."
    )

    def figures(self) -> Figures:
        """What registers show of it."""
        return Figures()

    def main_figure(self) -> MainFigure | None:
        """What a list of runs shows of it; None for a kind that has no such figure."""
        return None

    def exported(self) -> tuple[str, Any] | None:
        """Name and value of the calibration that it holds, for other programs; None: it holds none."""
        return None

    def judged(self, reasons: Sequence[str], warnings: Sequence[Warning_] = ()) -> Self:
        """With more findings: any of the ``reasons``, which stand first, fails it; warnings make a pass a
        warn."""
        verdict = "fail" if reasons else "warn" if warnings and self.verdict == "pass" else self.verdict
        return self.changed(
            verdict=verdict, reasons=[*reasons, *self.reasons], warnings=[*self.warnings, *warnings]
        )

    def with_inputs(self, **figures: Any) -> Self:
        """With these figures in its ``inputs``."""
        return self.model_copy(update={"inputs": self.made_from().changed(**figures)})

    def made_from(self) -> Inputs:
        """Its ``inputs``; a kind of another package may have none."""
        own = getattr(self, "inputs", None)
        return own if isinstance(own, Inputs) else Inputs()

    def signed(self) -> Self:
        """With the name and version of this program, which made it."""
        return self.model_copy(update={"software": software()})

    def as_json(self) -> dict[str, Any]:
        """Plain values with the names of the format."""
        return self.model_dump(mode="json", by_alias=True)


class Result(Envelope):
    """A result of whatever kind. ``result`` is null when the data cannot determine it; see ``reasons``."""

    result: dict[str, Any] | None
    uncertainty: dict[str, Any] = Field(default_factory=dict)
    residuals: dict[str, Any] = Field(default_factory=dict)
    heldout: dict[str, Any] = Field(default_factory=dict)
    observability: dict[str, Any] = Field(default_factory=dict)
    inputs: Inputs = Field(default_factory=Inputs)

    def figures(self) -> Figures:
        return NO_FIGURES if self.result is None else Figures()


def read_as(model: type[M], document: Mapping[str, Any], where: str = "the result") -> M:
    """``document`` as ``model``; ``RESULT_INVALID`` names ``where`` and the first field that does not fit."""
    try:
        return model.model_validate(document)
    except ValidationError as exc:
        first, *more = exc.errors(include_url=False)
        said = "is missing" if first["type"] == "missing" else f"does not fit: {first['msg']}"
        others = f" (and {len(more)} more findings)" if more else ""
        raise error("RESULT_INVALID", f"{where}: {path_in(first['loc'], model)} {said}{others}") from exc
