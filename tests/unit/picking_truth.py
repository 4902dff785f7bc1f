"""What picking counts, beside what the world's gripper truly did."""

from dataclasses import dataclass

from daemon.plc import PlcFace
from procedures.belt.items import CONTACT, Outcome
from tests.object_cell import ObjectCell


@dataclass(frozen=True)
class Truth:
    """How often the world's fingers have closed, and on what they took."""

    closed: int
    taken: tuple[int, ...]


def truth_of(cell: ObjectCell) -> Truth:
    gripper = cell.plant.world.gripper
    assert gripper is not None
    gripper.settle(cell.clock.now())
    taken = tuple(c.item for c in gripper.contacts if c.taken and c.item is not None)
    return Truth(len(gripper.contacts), taken)


def counted(cell: ObjectCell, run_id: int) -> dict[str, int]:
    """What the ledger says, by outcome."""
    outcomes = [row["outcome"] for row in cell.ledger.items(run_id)]
    return {outcome.value: outcomes.count(outcome) for outcome in Outcome}


NOTHING = Truth(0, ())


def agrees_with_the_world(cell: ObjectCell, run_id: int, before: Truth = NOTHING, where: str = "") -> None:
    """Journal, ledger and registers of a run that ended; ``before`` is the truth when it began."""
    after, rows = truth_of(cell), cell.ledger.items(run_id)
    assert len(set(after.taken)) == len(after.taken), f"{where}: an item was picked twice"
    numbers = [row["item"] for row in rows]
    assert len(set(numbers)) == len(numbers), f"{where}: an item ended twice"
    touched = [row for row in rows if any(what == CONTACT for _, what in row["detail"]["history"])]
    unsure = sum(row["outcome"] == Outcome.LOST for row in touched)  # in the gripper when the job ended
    assert unsure <= 1, where
    outcomes, taken = counted(cell, run_id), len(after.taken) - len(before.taken)
    assert outcomes["picked"] <= taken <= outcomes["picked"] + unsure, (where, outcomes, taken)
    assert len(touched) - unsure <= after.closed - before.closed <= len(touched), (where, outcomes)
    events = [line["outcome"] for line in cell.notes(run_id, "item")]
    assert sorted(events) == sorted(row["outcome"] for row in rows), where
    shown = PlcFace(cell.config, cell.engine).snapshot()
    misses = {o.value: shown.get(f"missed_{o.value.replace(' ', '_')}", 0) for o in Outcome}
    assert {**misses, "picked": shown.get("picks", 0)} == outcomes, where
    assert shown.get("misses", 0) == sum(misses.values()), where
