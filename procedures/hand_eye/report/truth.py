"""What was found and stated beside the truth, in the run of a twin: pose, lens, print and arm."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from calibration.planning import PredictedUncertainty
from cell.store.files import read_json
from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.result import HandEyeAnswer, HandEyeResult
from procedures.hand_eye.solve.capture import FILE_NAME
from procedures.hand_eye.truth import arm_beside_truth, judge
from procedures.report.html import Html, note, section, table
from procedures.report.numbers import K95, deg, mm

TITLE = "Beside the twin's truth"
HEAD = ("", "found", "truth", "off", "stated: 95 % below")

Row = tuple[str, str, str, str, str]


def truth_section(source: HandEyeSource) -> Html | None:
    """Found and stated beside what the twin knows; None for a real cell, where it is unknown."""
    result = source.found
    if not source.truth or result is None or not result.result.cov:
        return None
    rows = [*_pose(result, source.truth), *_parts(result.result, source.truth), *_arm(source, result)]
    return section(
        TITLE,
        table(HEAD, rows, "lrrrr"),
        note(
            "One run in twenty lies beyond each stated length by chance. The camera's pose is the one that "
            "serves best with the arm as it is configured; arms are compared after the best base and flange, "
            "at joints that were not measured."
        ),
    )


def _pose(result: HandEyeResult, truth: Mapping[str, Any]) -> Iterator[Row]:
    judged, sure = judge(result, truth), PredictedUncertainty(np.array(result.result.cov))
    t, r = float(np.linalg.norm(judged.xi[:3])), float(np.linalg.norm(judged.xi[3:]))
    yield "camera, place", "", "", mm(t), mm(sure.error95_t_m)
    yield "camera, rotation", "", "", deg(r), deg(sure.error95_r_rad)


def _parts(answer: HandEyeAnswer, truth: Mapping[str, Any]) -> Iterator[Row]:
    """Lens and print, where they are unknowns."""
    lens, scale = (answer.unknowns or {}).get("lens"), answer.target_scale
    if lens is not None and answer.lens is not None:
        found, true = answer.lens.K, truth["camera"]["K"]
        sigma = {"focal length x": found[0] * lens["focal"].sigma}
        sigma |= {"principal point x": lens["cx"].sigma, "principal point y": lens["cy"].sigma}
        for (name, s), k in zip(sigma.items(), (0, 2, 3), strict=True):
            off, limit = abs(found[k] - true[k]), K95 * s
            yield name, f"{found[k]:.2f} px", f"{true[k]:.2f} px", f"{off:.2f} px", f"{limit:.2f} px"
    if scale is not None:
        for axis, value, s in (("x", scale.x, scale.sigma_x), ("y", scale.y, scale.sigma_y)):
            printed = truth["target_print"][f"scale_{axis}"]
            numbers = (value, printed, abs(value - printed), K95 * s)
            found_, true_, off_, limit_ = (f"{100 * v:.3f} %" for v in numbers)
            yield f"printed size {axis}", found_, true_, off_, limit_


def _arm(source: HandEyeSource, result: HandEyeResult) -> Iterator[Row]:
    """RMS of the arm's errors before and after; the last two columns are 95 % of them, true and stated."""
    answer = result.result
    if answer.arm is None or answer.robot is None or source.folder is None:
        return
    configured = read_json(source.folder / FILE_NAME)["robot"]
    for row in arm_beside_truth(answer.arm, answer.robot, source.truth["robot"], configured):
        yield f"arm {row.name}, RMS", mm(row.stated.t), mm(row.rms), mm(row.p95), mm(row.stated.t95)
