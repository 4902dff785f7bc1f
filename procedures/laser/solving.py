"""From the data sets of a run to answers: the solver's, with what the jobs add to its documents."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.tool_frame.meeting import tool_point_meets
from cell.poses import from_pose6
from cell.store.files import read_json
from procedures.solve.laser import solve_laser, solve_reference

REFERENCE_SCHEMA = "cellward.laser-reference/1"


def solve_new_reference(path: Path, known: Mapping[str, Any]) -> dict[str, Any]:
    """The result of ``laser-reference``; its ``result`` is the reference document.

    ``known`` has ``search`` and ``T_flange_tool``, which every later measurement starts from.
    """
    result = solve_reference(path, calls=1)
    answer = result["result"]
    if answer is None:
        return result
    data = read_json(path)
    document = {
        "schema": REFERENCE_SCHEMA,
        "tool": data["tool"],
        "R_base_flange": data["R_base_flange"],
        **answer,
        "tau_s": answer["tau"],
        **known,
        "passes": data["reference"]["passes"],
    }
    return {**result, "result": document}


def solve_current(path: Path) -> dict[str, Any]:
    """The tool of a data set against its reference."""
    return solve_laser(path, calls=1)


def compare_second(path: Path, first: Mapping[str, Any], reference: Mapping[str, Any]) -> dict[str, Any]:
    """Whether the point of the candidate that ``first`` (a result) led to meets the reference.

    ``apart`` is its distance from the reference's hit and ``apart_m`` (3,) that in the base, ``U_m`` what
    95 % of such distances stay below; None where the second scan cannot be solved: ``reasons`` say why.
    """
    second = solve_laser(path, calls=1)
    answer = second["result"]
    if answer is None:
        unknown = {"apart": None, "apart_m": None, "U_m": None, "U_point_m": None}
        return {"meets": False, **unknown, "reasons": second["reasons"]}
    meeting = tool_point_meets(
        t_new=from_pose6(first["T_flange_tool"]).translation,
        t_ref=from_pose6(reference["T_flange_tool"]).translation,
        dp_second=np.array(answer["dp_flange"]),
        cov_second=np.array(answer["cov"]),
        cov_new=np.array(first["cov"]),
        R=Rotation.from_rotvec(reference["R_base_flange"]).as_matrix(),
    )
    return {
        "meets": bool(meeting.meets),
        "apart": meeting.distance,
        "apart_m": meeting.apart.tolist(),
        "U_m": meeting.U,
        "U_point_m": second["uncertainty"]["U_point_m"],
        "reasons": [],
    }
