"""A calibrated arm beside the twin's truth: how far its predictions are off where nothing was measured."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import error
from cell.poses import Array, from_pose6
from cell.store.files import read_json
from procedures.beside_truth import SURE_POINT, Judged
from procedures.tracker.judging import places
from procedures.tracker.record import DATA_FILE, HELD_OUT_FILE
from procedures.tracker.result import KincalAnswer, KincalResult
from procedures.twin_arm import actual_joints, observed_flange, true_links
from procedures.words import table

ELSEWHERE = 200
PREDICTIONS = "95 % of the predictions"


def judge_arm(result: KincalResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Predictions at the joints that were set aside, and at joints all over the sampled ranges.

    Good when 95 % of those elsewhere are within the promised 95 % limit at the worst place, widened as the
    other verdicts widen theirs: one result has one error, which shows everywhere.
    """
    solved, aside = read_json(folder / DATA_FILE)["samples"], read_json(folder / HELD_OUT_FILE)["samples"]
    Q = np.array([s["q"] for s in solved])
    sampled = np.random.default_rng(0).uniform(Q.min(axis=0), Q.max(axis=0), (ELSEWHERE, Q.shape[1]))
    elsewhere = [{"q": q.tolist(), "target": solved[0]["target"]} for q in sampled]
    answer, tracker = result.result, truth["tracker"]
    facts, accuracy, held_out = result.inputs.sampling, answer.absolute_accuracy, result.heldout.set_aside
    if facts is None or accuracy is None or held_out is None:
        raise error("SOLVE_REFUSED", "the result is not of a sampling with poses set aside")
    together = "solved alone"
    if facts.stored is not None:
        together = (
            f"solved together with a stored set of {facts.stored.samples} poses that this twin's tracker "
            "measured earlier"
        )
    promised = accuracy.predicted_95
    observed = facts.role == "observed_arm"
    off, off_aside = (_errors(answer, truth, samples, observed) for samples in (elsewhere, aside))
    good = float(np.percentile(off, 95)) <= SURE_POINT * promised
    ranges = np.linalg.norm([s["p_tracker"] for s in aside], axis=1)
    sigma = tracker["sigma0_m"] + tracker["sigma_per_m"] * float(np.mean(ranges))
    nominal_off = held_out.rms.registration_only or 0.0
    rows = [
        (name, str(len(e)), _mm(np.sqrt(np.mean(e**2))), _mm(np.percentile(e, 95)), _mm(e.max()))
        for name, e in (("set aside", off_aside), ("elsewhere", off))
    ]
    words = "consistent with" if good else "NOT consistent with"
    text = [
        f"{facts.measured} poses of this run, {facts.set_aside} of them set aside, {together}",
        "errors of predicted reflector positions against the twin's own arm, without noise; mm",
        table(("joints", "number", "RMS", "95 % below", "largest"), rows),
        f"the nominal arm in its best place is {_mm(nominal_off)} mm off (RMS); one reading of the tracker "
        f"has a sigma of {_mm(sigma)} mm along each axis there",
        f"{words} the promise: 95 % below {_mm(promised)} mm at the worst place",
    ]
    stated = f"95 % below {1e3 * promised:.3f} mm"
    p95 = float(np.percentile(off, 95))
    off95, of95 = f"95 % below {1e3 * p95:.3f} mm", {PREDICTIONS: p95 / promised}
    limits95 = {PREDICTIONS: (promised, "m")}
    return Judged(good, "\n".join(text), stated, off95, p95 <= promised, of95, limits95)


def _errors(
    answer: KincalAnswer, truth: Mapping[str, Any], samples: list[Any], observed: bool = False
) -> Array:
    """(n,) m between where the answer and where the truth has the reflectors, in the tracker's frame.

    ``observed``: they are on the arm that is only read.
    """
    tracker = truth["tracker"]
    true_places = _on_observed(truth, samples) if observed else _on_arm(truth, samples)
    true = from_pose6(tracker["T_base_tracker"]).inv().apply(true_places)
    predicted = from_pose6(answer.T_tracker_base).apply(places(answer.robot, samples))
    out: Array = np.linalg.norm(predicted - true, axis=1)
    return out


def _on_arm(truth: Mapping[str, Any], samples: list[Any]) -> Array:
    """(n, 3) m in the base of the arm that is moved."""
    robot, reflectors = truth["robot"], truth["tracker"]["reflectors"]
    tools = {name: r["point"] for name, r in reflectors.items() if r["on"] == "arm"}
    Q = actual_joints(robot, np.array([s["q"] for s in samples]))
    turned = [s | {"q": q} for s, q in zip(samples, Q, strict=True)]
    return places(true_links(robot) | {"tool": tools}, turned)


def _on_observed(truth: Mapping[str, Any], samples: list[Any]) -> Array:
    """(n, 3) m in the base of the arm that is only read, a palletizer."""
    reflectors = truth["tracker"]["reflectors"]
    flange = observed_flange(truth["observed"], np.array([s["q"] for s in samples]))
    points = np.array([reflectors[s["target"]]["point"] for s in samples])
    out: Array = np.einsum("nij,nj->ni", flange[:, :3, :3], points) + flange[:, :3, 3]
    return out


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.4f}"
