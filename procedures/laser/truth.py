"""The results of the crossed-beam jobs beside the twin's truth."""

from collections.abc import Mapping
from math import asin, degrees
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.kinematics import robot_from_spec
from cell.errors import error
from cell.poses import Array, from_pose6
from cell.store.files import read_json
from procedures.beside_truth import SURE, SURE_POINT, SURE_TILT, Judged
from procedures.laser.config import BEAMS
from procedures.laser.result import LaserResult, ReferenceResult
from procedures.twin_arm import true_flange
from procedures.words import table


def judge_tool(result: LaserResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """The tool frame against the true one: where its point is, and which way its axis goes.

    That of an update must have been put into effect too; a check only measures.
    """
    held, U, U_tilt = result.result.T_flange_tool, result.uncertainty.U_point_m, result.uncertainty.U_tilt_rad
    if held is None or U is None or U_tilt is None:
        raise error("SOLVE_REFUSED", "the result has no tool frame with its uncertainty")
    found, true = from_pose6(held), from_pose6(truth["T_flange_tool"])
    off = found.translation - true.translation
    apart = float(np.linalg.norm(off))
    tilt = _angle(_axis(found), _axis(true))
    update = result.inputs.update
    accepted = update is not None and bool(update.committed)
    good = (accepted or update is None) and apart <= SURE_POINT * U and tilt <= SURE_TILT * U_tilt
    beyond = apart > U or tilt > U_tilt
    rows = [
        (f"point {axis}, mm", *(f"{1e3 * v[i]:.4f}" for v in (found.translation, true.translation, off)))
        for i, axis in enumerate("xyz")
    ]
    words = "consistent with" if good else "NOT consistent with"
    text = [
        f"T_flange_tool {'as measured' if update is None else 'after the correction'}",
        table(("", "found", "truth", "error"), rows),
        f"the point is {1e3 * apart:.4f} mm off (U95 {1e3 * U:.4f} mm), "
        f"the axis {degrees(tilt):.4f} deg (U95 {degrees(U_tilt):.4f} deg)",
        f"{words} the stated uncertainty{_beyond(beyond) if good else ''}",
    ]
    if update is not None:
        effect = "the second scan met the reference and the new frame is in effect"
        text.append(effect if accepted else "the new frame was NOT put into effect")
    stated = f"U95 {1e3 * U:.3f} mm, {degrees(U_tilt):.3f} deg"
    off_text = f"{1e3 * apart:.3f} mm, {degrees(tilt):.3f} deg"
    of95 = {"point": apart / U, "tilt": tilt / U_tilt}
    limits95 = {"point": (U, "m"), "tilt": (U_tilt, "rad")}
    return Judged(good, "\n".join(text), stated, off_text, not beyond, of95, limits95)


def _beyond(beyond: bool) -> str:
    """An error beyond its 95 % bound is said to be: 1 of 20 is, and the test is made at ``SURE``."""
    return f": beyond the 95 % bound, as 1 of 20 is, and within the {SURE} bound" if beyond else ""


def judge_beams(result: ReferenceResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """The beams of a reference against the true ones: how far apart where they are crossed, and the angle.

    The point of the tool breaks a beam of light when it is within the beam's radius, so the line that it
    meets lies that much above the middle of the light. The arm says where that is, so its own error there is
    taken off the truth: no crossing of a beam shows it, and it cancels in a check and in an update.
    """
    limit = SURE_POINT * result.uncertainty.U_point_m
    good, worst, rows = True, 0.0, []
    found = {name: np.array(beam.point) for name, beam in result.result.beams.items()}
    said = _as_the_arm_says(truth["robot"], read_json(folder / "run.json"), found)
    for name, beam in result.result.beams.items():
        point, line = found[name], np.array(beam.dir)
        true = truth["beams"][name]
        upper = np.array([0.0, 0.0, true["radius_m"] - 0.5 * true["hysteresis_m"]])
        light, way = np.array(true["point"]) + upper, _unit(np.array(true["dir"]))
        arm = said[name]
        apart = _distance(point, arm.apply(light), arm.rotation.apply(way))
        good, worst = good and apart <= limit, max(worst, apart)
        off_in_base = _distance(point, light, way)
        rows.append(
            (
                name,
                f"{1e3 * apart:.4f}",
                f"{1e3 * _angle(line, arm.rotation.apply(way)):.3f}",
                f"{1e3 * off_in_base:.4f}",
            )
        )
    words = "consistent with" if good else "NOT consistent with"
    text = table(
        ("beam", "off the true line, mm", "angle between, mrad", "with the arm's own error there, mm"), rows
    )
    stated = f"U95 {1e3 * limit / SURE_POINT:.3f} mm"
    return Judged(
        good,
        f"{text}\n{words} the stated uncertainty (U95 of the point {1e3 * limit / SURE_POINT:.4f} mm)",
        stated,
        f"{1e3 * worst:.3f} mm",
        worst <= result.uncertainty.U_point_m,
        {"the worse beam": worst / result.uncertainty.U_point_m},
        {"the worse beam": (result.uncertainty.U_point_m, "m")},
    )


def _as_the_arm_says(
    robot: Mapping[str, Any], run: Mapping[str, Any], found: Mapping[str, Array]
) -> dict[str, RigidTransform]:
    """By input: from where something truly is, with the tool's point at ``found`` (3,) m, to where the arm
    says it is. A few centimetres beside that its error is another one by a hundredth of a millimetre."""
    believed, tool = robot_from_spec(run["values"]["robot"]), run["values"]["tool"]["T_flange_tool"]
    q_aux = {n: np.array(run["values"]["poses"][run["job_config"][n]["aux"]]) for n in BEAMS}
    R = believed.forward(q_aux[BEAMS[0]]).rotation  # of the whole scan
    said = {}
    for name in BEAMS:
        beam = run["job_config"][name]["input"]
        flange = RigidTransform.from_components(found[beam] - R.apply(from_pose6(tool).translation), R)
        q = believed.inverse(flange, q_aux[name])
        if q is None:
            raise error("SOLVE_REFUSED", f"the arm does not get to where beam {beam} was found")
        true = RigidTransform.from_matrix(true_flange(robot, q[None])[0])
        said[beam] = believed.forward(q) * true.inv()
    return said


def _axis(T: Any) -> Array:
    z: Array = T.rotation.as_matrix()[:, 2]
    return z


def _unit(v: Array) -> Array:
    u: Array = v / np.linalg.norm(v)
    return u


def _angle(a: Array, b: Array) -> float:
    """Between two lines, rad."""
    return asin(min(float(np.linalg.norm(np.cross(_unit(a), _unit(b)))), 1.0))


def _distance(p: Array, q: Array, u: Array) -> float:
    """Of ``p`` from the line through ``q`` along the unit vector ``u``."""
    return float(np.linalg.norm(np.cross(p - q, u)))
