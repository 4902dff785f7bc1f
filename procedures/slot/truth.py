"""An insertion beside the twin's truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.poses import from_pose6
from procedures.beside_truth import SURE_TILT, Judged
from procedures.slot.result import SlotResult
from procedures.words import mm


def judge_slot(result: SlotResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Good when the part ends where the result says, and within what was predicted."""
    answer, rack = result.result, truth["rack"]
    if answer.budget is None or answer.part != "released":
        return Judged(answer.part in ("released", "gripped"), f"the part was {answer.part}", answer.part, "")
    T_slot = from_pose6(rack["slots"][answer.slot - 1])
    off = min(_beside(T_slot, from_pose6(part)) for part in rack["parts"])
    predicted = answer.budget.predicted_95_m
    text = f"the part is {mm(off)} beside the middle of slot {answer.slot}, predicted {mm(predicted)} (95 %)"
    good, name = off <= SURE_TILT * predicted, "beside the middle"
    stated = f"part less than {mm(predicted)} beside the middle of slot {answer.slot} (95 %)"
    of95, limits95 = {name: off / predicted}, {name: (predicted, "m")}
    return Judged(good, text, stated, f"{mm(off)} beside it", off <= predicted, of95, limits95)


def _beside(T_base_slot: RigidTransform, T_base_part: RigidTransform) -> float:
    return float(np.linalg.norm((T_base_slot.inv() * T_base_part).translation[:2]))
