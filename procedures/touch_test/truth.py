"""A touch test beside the twin's truth: a tool that is bent, and else nothing, should show at the board."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.touch import common_motion
from cell.errors import error
from cell.poses import from_pose6
from procedures.beside_truth import SURE_POSE, Judged, all_inside
from procedures.touch_test.data import read_data_set
from procedures.touch_test.judging import points_of
from procedures.touch_test.result import TouchResult
from procedures.words import deg, mm


def judge_touch(result: TouchResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Good when shift and turn, less those by which the twin's tool is bent, are within their covariance: the
    camera of such a twin was calibrated by itself, and nobody moved it since."""
    data, _ = read_data_set(folder)
    if data.look is None:
        raise error("SOLVE_REFUSED", "the board was not seen")
    answer, of = result.result, result.uncertainty
    standing, off = points_of(data, data.look)
    bent = np.array(data.tool) - from_pose6(truth["T_flange_tool"]).translation
    told = common_motion(standing.places, off.by_tool @ bent)
    xi = np.concatenate([np.array(answer.shift) - told.shift, np.array(answer.turn) - told.turn])
    m2 = float(xi @ np.linalg.solve(np.array(of.cov), xi))
    shift, turn = (float(np.linalg.norm(part)) for part in (xi[:3], xi[3:]))
    good = m2 <= SURE_POSE
    text = (
        f"the tool is bent by {mm(float(np.linalg.norm(bent)))}; beyond that {mm(shift)} and {deg(turn)} "
        f"were found; squared Mahalanobis distance {m2:.1f} (6 expected, limit {SURE_POSE:.1f}): "
        f"{'consistent with' if good else 'NOT consistent with'} the stated uncertainty"
    )
    stated = (
        f"shift {mm(answer.shift_m)} +- {mm(of.shift_95_m)}, turn {deg(answer.turn_rad)} +- "
        f"{deg(of.turn_95_rad)} (95 %)"
    )
    # The true ones are told too: of a tool that is not bent they are zero, and all that is stated is error.
    true = f"{mm(float(np.linalg.norm(told.shift)))} and {deg(float(np.linalg.norm(told.turn)))}"
    apart = f"shift by {mm(shift)}, turn by {deg(turn)} (truly {true})"
    of95 = {"shift": shift / of.shift_95_m, "turn": turn / of.turn_95_rad}
    limits95 = {"shift": (of.shift_95_m, "m"), "turn": (of.turn_95_rad, "rad")}
    return Judged(good, text, stated, apart, all_inside(of95), of95, limits95)
