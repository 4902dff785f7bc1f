"""An insertion in words: what became of the part, where the slot was, and the budget by cause."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from procedures.plan_words import plan_lines
from procedures.slot.result import SlotAnswer, SlotResult
from procedures.words import deg, mm, pose_text, table

_STATES = {
    "none": "no part was taken",
    "gripped": "the gripper holds the part",
    "inserted": "the part is in the slot, and the gripper holds it still",
    "jammed": "the part is stuck or met something, and was drawn back",
    "released": "the part was let go where it belongs",
    "lost": "the gripper lost the part",
}


def slot_lines(found: SlotResult) -> list[str]:
    """What a person wants to know of it."""
    answer, t = found.result, found.result.correction.t
    shift, turn = (float(np.linalg.norm(v)) for v in (t, answer.correction.r))
    lines = [
        f"  {answer.action}, slot {answer.slot} (row {answer.row}, column {answer.column}): "
        f"{_STATES[answer.part]}",
        f"  T_base_slot = {pose_text(answer.T_base_slot)}",
        f"  corrected by {mm(shift)}, {deg(turn)} against the rack's model",
        *budget_lines(answer),
    ]
    if answer.travel_m is not None:
        lines.append(f"  travel {mm(answer.travel_m)}, force {answer.force_n or 0.0:.1f} N")
    return lines + [f"  not measured: {words}" for words in found.observability.undetermined]


def budget_lines(answer: SlotAnswer) -> list[str]:
    """The error budget of an insertion by cause."""
    budget = answer.budget
    if budget is None:
        return []
    rows = [[row.source, mm(row.error95_m)] for row in budget.by_source]
    rows += [["all together", mm(budget.predicted_95_m)], ["free on each side", mm(budget.clearance_m)]]
    return [table(("  beside the middle, 95 %", ""), [["  " + name, size] for name, size in rows])]


def slot_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """What will be done, and the stations with their margins, before anything moves."""
    return [
        f"{plan['action']}, slot {plan['slot']} (row {plan['row']}, column {plan['column']}): travel "
        f"{mm(plan['travel_m'], 1)}, ended by {plan['max_force_n']:g} N",
        *plan_lines(plan),
    ]
