"""What picking counts, beside what the world's gripper truly did."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from daemon.plc import PlcFace
from procedures.belt.items import CONTACT, Outcome
from tests.kit.object_cell import ObjectCell

MISSES = {o: f"missed_{o.value.replace(' ', '_')}" for o in Outcome if o is not Outcome.PICKED}


@dataclass(frozen=True)
class Truth:
    """How often the world's fingers have closed, and on what they took."""

    closed: int
    taken: tuple[int, ...]


@dataclass(frozen=True)
class Told:
    """What a run that ended says of its items: the ledger's rows, outcomes in the journal, registers."""

    rows: Sequence[Mapping[str, Any]]
    events: Sequence[str]
    registers: Mapping[str, float]
    counted: Mapping[str, int] | None = None  # the journal's last count: ``seen``, and still ``waiting``
    interrupted: int = 0  # times that a short silence stopped the arm

    @property
    def outcomes(self) -> dict[str, int]:
        """What the ledger says, by outcome."""
        ended = [row["outcome"] for row in self.rows]
        return {outcome.value: ended.count(outcome) for outcome in Outcome}

    def agrees(self, before: Truth, after: Truth, where: str = "") -> None:
        """The three say the same, and it is what truly happened between ``before`` and ``after``."""
        assert len(set(after.taken)) == len(after.taken), f"{where}: an item was picked twice"
        numbers = [row["item"] for row in self.rows]
        assert len(set(numbers)) == len(numbers), f"{where}: an item ended twice"
        touched = [row for row in self.rows if any(what == CONTACT for _, what in row["detail"]["history"])]
        # In the gripper when the job ended, or when a silence interrupted it.
        unsure = sum(row["outcome"] == Outcome.LOST for row in touched)
        assert unsure <= 1 + self.interrupted, where
        outcomes, taken = self.outcomes, len(after.taken) - len(before.taken)
        assert outcomes["picked"] <= taken <= outcomes["picked"] + unsure, (where, outcomes, taken)
        again = sum(what == "not held" for row in touched for _, what in row["detail"]["history"])
        closed = after.closed - before.closed
        assert len(touched) - unsure <= closed <= len(touched) + again, (where, outcomes)
        assert sorted(self.events) == sorted(row["outcome"] for row in self.rows), where
        misses = {outcome.value: self.registers.get(name, 0) for outcome, name in MISSES.items()}
        assert {**misses, "picked": self.registers.get("picks", 0)} == outcomes, where
        assert self.registers.get("misses", 0) == sum(misses.values()), where
        if self.counted is not None:
            assert self.counted["seen"] == len(self.rows) + self.counted["waiting"], (where, self.counted)


def truth_of(cell: ObjectCell) -> Truth:
    gripper = cell.plant.world.gripper
    assert gripper is not None
    gripper.settle(cell.clock.now())
    taken = tuple(c.item for c in gripper.contacts if c.taken and c.item is not None)
    return Truth(len(gripper.contacts), taken)


def told(cell: ObjectCell, run_id: int) -> Told:
    events = [line["outcome"] for line in cell.notes(run_id, "item")]
    counts = [{key: line[key] for key in ("seen", "waiting")} for line in cell.notes(run_id, "counted")]
    assert len(counts) <= 1
    counted = counts[0] if counts else {"seen": 0, "waiting": 0}  # it ended before it looked at the belt
    interrupted = len(cell.notes(run_id, "interrupted"))
    registers = PlcFace(cell.config, cell.engine).snapshot()
    return Told(cell.ledger.items(run_id), events, registers, counted, interrupted)


def counted(cell: ObjectCell, run_id: int) -> dict[str, int]:
    """What the ledger says, by outcome."""
    return Told(cell.ledger.items(run_id), [], {}).outcomes


NOTHING = Truth(0, ())


def agrees_with_the_world(cell: ObjectCell, run_id: int, before: Truth = NOTHING, where: str = "") -> None:
    """Journal, ledger and registers of a run that ended; ``before`` is the truth when it began."""
    told(cell, run_id).agrees(before, truth_of(cell), where)
