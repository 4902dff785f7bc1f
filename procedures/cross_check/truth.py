"""The part that a cross check names beside what has truly changed in a twin between its two captures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cell.poses import from_pose6
from procedures.beside_truth import SURE_SCALAR, Judged
from procedures.cross_check.result import CrossCheckResult
from procedures.cross_check.words import JOINTS, said
from procedures.words import deg, mm

LIMIT95 = 1.96  # of one number, as the size of a change is, in its standard deviation
STILL = 1e-9  # m and rad


def judge_change(result: CrossCheckResult, then: Mapping[str, Any], now: Mapping[str, Any]) -> Judged:
    """``then`` and ``now`` are the twin's truths at the two captures.

    Good when what alone has changed is named, and by how far it moved and turned, as far as that is
    stated: within what is stated, widened to ``SURE``. ``cannot-tell`` is right of several changes alone.
    """
    answer, changed = result.result, _changed(then, now)
    named = f"zero of {answer.joint}" if answer.part == "joint zero" else answer.part
    true = next(iter(changed)) if len(changed) == 1 else "cannot-tell" if changed else "none"
    good, stated, off = named == true, named, "-" if named == true else f"truly: {true}"
    told = ", ".join(f"{part} by {1e3 * t:.3f} mm, {1e3 * r:.3f} mrad" for part, (t, r) in changed.items())
    lines = [f"named: {said(answer)}", f"truly changed: {told or 'nothing'}"]
    t, r = changed.get(named, (0.0, 0.0))
    if good and answer.r is not None and answer.r_sigma is not None:
        bound, apart = LIMIT95 * answer.r_sigma, abs(abs(answer.r) - r)
        good = apart <= SURE_SCALAR * bound
        stated, off = f"{named}, by {deg(answer.r)} +- {deg(bound)} (95 %)", deg(apart)
    if good and answer.t is not None and answer.t_sigma is not None:
        bound, apart = LIMIT95 * answer.t_sigma, abs(answer.t - t)
        good = apart <= SURE_SCALAR * bound
        stated, off = f"{named}, by {mm(answer.t)} +- {mm(bound)} (95 %)", mm(apart)
    lines.append(f"{'consistent' if good else 'NOT consistent'} with what has truly changed")
    return Judged(good, "\n".join(lines), stated, off)


def _changed(then: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """What is elsewhere now, and by how much: m of the tool's point or the camera, and rad."""
    found = {
        "tool": _moved(then["T_flange_tool"], now["T_flange_tool"]),
        "camera": _moved(_camera(then), _camera(now)),
    }
    zeros = np.subtract(*(truth["robot"]["error"]["delta_theta"] for truth in (now, then)))
    found |= {f"zero of {JOINTS[k]}": (0.0, abs(float(zero))) for k, zero in enumerate(zeros)}
    return {part: by for part, by in found.items() if max(by) > STILL}


def _camera(truth: Mapping[str, Any]) -> Sequence[float]:
    """The pose (6,) at which it truly sits on the flange or in the base."""
    mechanical = truth["mechanical"]
    pose: Sequence[float] = mechanical.get("T_flange_camera") or mechanical["T_base_camera"]
    return pose


def _moved(then: Sequence[float], now: Sequence[float]) -> tuple[float, float]:
    """m of its origin, and rad."""
    motion = from_pose6(then).inv() * from_pose6(now)
    return float(np.linalg.norm(motion.translation)), float(motion.rotation.magnitude())
