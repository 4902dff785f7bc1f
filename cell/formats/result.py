"""``cellward.result/1``: what every solver answers with."""

from typing import Annotated, Any, Literal

from pydantic import Field

from cell.formats.reading import Strict

SCHEMA = "cellward.result/1"

Verdict = Literal["pass", "warn", "fail"]


class Warning_(Strict):
    """A finding that does not stop the solver; ``code`` is fixed, ``text`` is for people."""

    code: str
    text: str


class Result(Strict):
    """One result. ``result`` is null when the data cannot determine the answer; ``reasons`` says why."""

    schema_: Annotated[str, Field(alias="schema")] = SCHEMA
    kind: str
    verdict: Verdict
    reasons: list[str] = Field(default_factory=list)
    warnings: list[Warning_] = Field(default_factory=list)
    result: dict[str, Any] | None
    uncertainty: dict[str, Any] = Field(default_factory=dict)
    residuals: dict[str, Any] = Field(default_factory=dict)
    heldout: dict[str, Any] = Field(default_factory=dict)
    observability: dict[str, Any] = Field(default_factory=dict)
    inputs: dict[str, Any] = Field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Plain values with the names of the format."""
        return self.model_dump(mode="json", by_alias=True)
