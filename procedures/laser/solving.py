"""From the data sets of a run to answers: the solver's, with what the jobs add to its documents."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.lengths import length95
from calibration.odds import FALSE_ALARM
from calibration.tool_frame.meeting import tool_point_meets
from calibration.tool_frame.places import at_current_places
from calibration.tool_frame.scene import Refused, ToolFrameScene
from calibration.tool_frame.solution import solve
from cell.errors import present
from cell.formats.laser import parse_laser
from cell.formats.result import Result
from cell.poses import from_pose6
from cell.store.files import read_json
from procedures.laser.packed import packed
from procedures.laser.record import DATA_FILE, SECOND, THIRD
from procedures.laser.result import LaserAnswer, ReferenceResult, SecondScan
from procedures.laser.solve.data import scene_of
from procedures.laser.solve.solver import solve_reference

REFERENCE_SCHEMA = "cellward.laser-reference/2"  # the first had the passes as the data set has them


def solve_new_reference(path: Path, known: Mapping[str, Any]) -> ReferenceResult | Result:
    """The result of ``laser-reference``; its ``result`` is the reference document.

    ``known`` has ``search`` and ``T_flange_tool``, which every later measurement starts from.
    """
    found = solve_reference(path, calls=1)
    if not isinstance(found, ReferenceResult):
        return found
    data = read_json(path)
    document = found.result.changed(
        schema_=REFERENCE_SCHEMA,
        tool=data["tool"],
        R_base_flange=data["R_base_flange"],
        tau_s=found.result.tau,
        passes=[packed(entry) for entry in data["reference"]["passes"]],
        **known,
    )
    return found.changed(result=document)


def compare_second(
    path: Path, first: LaserAnswer, reference: Mapping[str, Any], chance: float = FALSE_ALARM
) -> SecondScan:
    """Whether the point of the candidate that ``first`` led to meets the reference.

    ``path`` is the data set of the first scan; those of the second and, if there is one, the third are in
    folders beside it and are used together. ``apart`` is the point's distance from the reference's hit and
    ``apart_m`` (3,) that in the base, ``U_m`` the distance that a right frame is beyond in ``chance`` of all
    scans, ``detectable_m`` the error of a frame that is found with 99 %; None where the scans cannot be
    solved: ``reasons`` say why. ``U_point_m`` is what 95 % of the errors of these scans stay below.
    """
    folders = [path.parent / name for name in (SECOND, THIRD)]
    passes = [p for f in folders if (f / DATA_FILE).exists() for p in _current(f / DATA_FILE)]
    scans = sum((f / DATA_FILE).exists() for f in folders)
    data = read_json(path)
    try:
        again = solve(_scene({**data, "current": {"passes": passes}}, path))
        between = solve(_against_first(data, passes, first, path))
    except Refused as refusal:
        return SecondScan(
            meets=False,
            scans=scans,
            false_alarm=chance,
            apart=None,
            apart_m=None,
            U_m=None,
            detectable_m=None,
            U_point_m=None,
            reasons=[str(refusal)],
        )
    meeting = tool_point_meets(
        t_new=from_pose6(present(first.T_flange_tool, "tool frame that was measured")).translation,
        t_ref=from_pose6(reference["T_flange_tool"]).translation,
        dp_first=np.array(first.dp_flange),
        between=between.dp,
        cov_between=between.cov,
        R=Rotation.from_rotvec(reference["R_base_flange"]).as_matrix(),
        chance=chance,
    )
    return SecondScan(
        meets=bool(meeting.meets),
        scans=scans,
        false_alarm=chance,
        apart=meeting.distance,
        apart_m=meeting.apart.tolist(),
        U_m=meeting.U,
        detectable_m=meeting.detectable,
        U_point_m=length95(again.cov[:3, :3]),
        reasons=[],
    )


def _current(path: Path) -> list[Any]:
    found: list[Any] = read_json(path)["current"]["passes"]
    return found


def _against_first(
    data: Mapping[str, Any], passes: list[Any], first: LaserAnswer, path: Path
) -> ToolFrameScene:
    """``passes`` held against the current ones of ``data``, whose tool is as ``first`` has it.

    So the noise of the reference, which both scans have alike, is not in the answer. The axis of the first
    scan is a measurement, and as open as that of ``passes``.
    """
    tool = dict(data["tool"])
    tool["p_ref"] = (np.array(tool["p_ref"]) + np.array(first.dp_flange)).tolist()
    if first.drot_flange is not None:
        tool["axis_ref"] = Rotation.from_rotvec(first.drot_flange).apply(tool["axis_ref"]).tolist()
    scene = _scene({**data, "tool": tool, "reference": data["current"], "current": {"passes": passes}}, path)
    return replace(scene, tool=replace(scene.tool, axis_known=False))


def _scene(data: dict[str, Any], path: Path) -> ToolFrameScene:
    return at_current_places(scene_of(parse_laser(data, str(path))))
