"""Short silences in mid-run, and everything that must tell of them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from cell.packml import PackML
from cell.procedure import Run
from daemon.plc import PlcFace
from tests.kit.object_cell import ObjectCell


@dataclass
class Struck:
    """A run in which devices were silent, as its operator and its PLC saw it."""

    cell: ObjectCell
    run_id: int = 0
    at: list[str] = field(default_factory=list)  # the states that were struck
    packml: set[PackML] = field(default_factory=set)  # while the run waited
    plc: PlcFace = field(init=False)

    def __post_init__(self) -> None:
        self.plc = PlcFace(self.cell.config, self.cell.engine)
        self.cell.engine.subscribe(self._look)

    def _look(self) -> None:
        run = self.cell.engine.running
        if run is not None and run.steps_taken.waiting:
            self.packml.add(self.cell.engine.packml)

    @property
    def end(self) -> dict[str, Any]:
        return self.cell.end(self.run_id)

    @property
    def taken_again(self) -> list[dict[str, Any]]:
        """The steps in the journal; each was interrupted before, and nothing else was."""
        again = self.cell.notes(self.run_id, "step taken again")
        interrupted = self.cell.notes(self.run_id, "interrupted")
        assert [line["step"] for line in again] == [line["step"] for line in interrupted]
        return again

    def tells_the_same_everywhere(self) -> None:
        """Journal, result, register, warning and PackML of a run that completed."""
        assert self.end["outcome"] == "complete", (self.at, self.end["error"])
        again = self.taken_again
        told = self.cell.result(self.run_id).get("inputs", {}).get("steps_taken_again", [])
        assert [entry["step"] for entry in told] == [line["step"] for line in again]
        assert all(entry["cause"] and entry["lost_s"] >= 0.0 for entry in told)
        shown = self.plc.snapshot()
        assert shown["steps_taken_again"] == len(again)
        assert bool(shown["warning_bits"] & 0b10) == bool(again)
        if again:
            assert PackML.SUSPENDED in self.packml


def silence_at(
    struck: Struck,
    device: str,
    moment: str,
    duration_s: float,
    after_s: float = 0.0,
    then: Callable[[Run], None] | None = None,
) -> None:
    """Once, ``after_s`` after the job came to ``moment``: ``device`` says nothing for ``duration_s``.

    ``then`` is called a fifth of a second into it.
    """
    cell, plant = struck.cell, struck.cell.plant.plants[device]

    def strike() -> None:
        run = cell.engine.running
        assert run is not None
        struck.at.append(run.state.value if run.state else "")
        plant.inject("silence", {"duration_s": duration_s})
        if then is not None:
            plant.later(0.2, lambda: then(run))

    cell.at_state(moment, strike, after_s)


async def run_struck(struck: Struck) -> Struck:
    """Run the cell's job to its end."""
    struck.run_id = await struck.cell.start()
    await struck.cell.finished(struck.run_id)
    await struck.cell.clock.sleep(0.5)
    assert struck.cell.at_rest()
    return struck
