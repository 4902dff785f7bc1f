"""Job ``acme-still``: does the belt stand still?"""

from enum import StrEnum
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from cell.devices import Encoder
from cell.formats.result import Envelope, Part, Verdict
from cell.procedure import Procedure, Run
from procedures.kind import Kind


class Config(BaseModel):
    """Keys of ``[job.acme-still]``."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    seconds: float = Field(default=1.0, gt=0, le=60, description="how long the belt is watched")


class State(StrEnum):
    WATCH = "watch"


class Answer(Part):
    """What was found."""

    counts: int = Field(description="counts of the encoder while the belt was watched")


class StillResult(Envelope):
    """The result of a run."""

    result: Answer


def lines(found: StillResult) -> list[str]:
    """The result for people."""
    return [f"  the belt moved by {found.result.counts} counts"]


KIND = Kind(name="acme_belt.still:KIND", words="acme_belt.still:lines", result="acme_belt.still:StillResult")


class BeltStill(Procedure):
    """Counts of the belt within ``seconds``; passes when there are none."""

    name, number, kind = "acme-still", 1001, KIND.name
    Config, State = Config, State
    TRANSITIONS: ClassVar[dict[Any, Any]] = {None: frozenset({State.WATCH}), State.WATCH: frozenset()}
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset({State.WATCH})

    def uses(self) -> tuple[str, ...]:
        return ("belt",)

    async def run(self, run: Run) -> None:
        await run.enter(State.WATCH)
        belt = run.device("belt", Encoder)
        before = belt.counts.latest(1.0).value.count
        await run.clock.sleep(self.config.seconds)
        moved = belt.counts.latest(1.0).value.count - before
        verdict: Verdict = "pass" if moved == 0 else "fail"
        run.result = StillResult(kind=self.kind, verdict=verdict, result=Answer(counts=moved))

    async def dry_run(self, run: Run) -> dict[str, Any]:
        return {"kind": self.kind, "seconds": self.config.seconds}
