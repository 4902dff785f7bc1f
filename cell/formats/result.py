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
    reasons: list[str] = []
    warnings: list[Warning_] = []
    result: dict[str, Any] | None
    uncertainty: dict[str, Any] = {}
    residuals: dict[str, Any] = {}
    heldout: dict[str, Any] = {}
    observability: dict[str, Any] = {}
    inputs: dict[str, Any] = {}

    def as_json(self) -> dict[str, Any]:
        """Plain values with the names of the format."""
        return self.model_dump(mode="json", by_alias=True)
