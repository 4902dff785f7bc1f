"""What remained off at corrected targets beside the twin's truth, which knows where the arm truly went."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import error
from cell.poses import Array, from_pose6
from procedures.beside_truth import Judged, all_inside, limit_of_worst
from procedures.corrected_targets.plan import place_of
from procedures.corrected_targets.record import DATA_FILE, read_data_set
from procedures.corrected_targets.result import TargetsResult
from procedures.twin_arm import observed_flange
from procedures.words import mm, table


def judge_targets(result: TargetsResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Good when all targets are truly off as stated, within limits that ``SURE`` of good runs keep, and the
    corrected ones are truly less off than as given. 95 % of good runs are inside at the worst of their
    targets, which is what ``of95`` has; ``limits95`` has the limit of that one.

    Truly off is what a tracker without noise would see at the joints at which the arm rested, with its stand
    where the calibration has it: the base is known by that alone. ``SOLVE_REFUSED`` where no tracker looked.
    """
    data = read_data_set(folder / DATA_FILE)
    stand = data.T_base_tracker
    if stand is None or data.reflector is None:
        raise error("SOLVE_REFUSED", "no tracker looked, and the base is known by it alone")
    apart: list[float] = []
    bounds: list[float] = []
    corrected: list[bool] = []
    true: dict[str, list[float]] = {"as given": [], "corrected": []}
    for target in result.result.targets:
        wanted = from_pose6(target.T_base_flange).apply(place_of(data.robot, data.reflector))
        for how, reached in (("as given", target.before), ("corrected", target.after)):
            if reached is None or reached.error_95_m is None:
                continue
            off = from_pose6(stand).apply(_seen(data.reflector, truth, reached.q)) - wanted
            true[how].append(float(np.linalg.norm(off)))
            apart.append(float(np.linalg.norm(off - reached.error)))
            bounds.append(reached.error_95_m)
            corrected.append(reached is target.after)
    shares = np.divide(apart, bounds)
    n = len(shares)
    as_stated = n > 0 and float(shares.max()) <= limit_of_worst(n, sure=True)
    better = not true["as given"] or _rms(true["corrected"]) < _rms(true["as given"])
    good, after = as_stated and better, result.result.after
    rows = [(how, str(len(off)), mm(_rms(off)), mm(max(off))) for how, off in true.items() if off]
    words = "consistent with" if good else "NOT consistent with"
    text = [
        "how far the reflector truly rested off its targets, without noise",
        table(("targets", "number", "RMS", "largest"), rows),
        f"what is stated of a target is up to {mm(max(apart, default=0.0))} off that; "
        f"95 % of it within {mm(max(bounds, default=0.0))}",
    ]
    if not better:
        text.append("corrected targets are truly NOT closer than as given")
    text.append(f"{words} what is stated")
    of95: dict[str, float] = {}
    limits95: dict[str, tuple[float, str]] = {}
    if n:
        name, worst = f"the worst of {n} arrivals", int(np.argmax(shares))
        of95[name] = float(shares[worst]) / limit_of_worst(n)
        limits95[name] = (bounds[worst] * limit_of_worst(n), "m")
    # The row is of corrected targets alone, as what is left of them is.
    k = int(np.argmax(np.where(corrected, shares, -1.0))) if any(corrected) else None
    return Judged(
        good,
        "\n".join(text),
        f"{mm(after.max_m)} left +- {mm(None if k is None else bounds[k])} (95 %)",
        mm(None if k is None else apart[k]),
        all_inside(of95),
        of95,
        limits95,
    )


def _seen(reflector: str, truth: Mapping[str, Any], q: list[float]) -> Array:
    """(3,) m: where the reflector truly is at joints ``q``, in the tracker's frame."""
    tracker = truth["tracker"]
    flange = observed_flange(truth["observed"], np.array([q]))[0]
    place = flange[:3, :3] @ np.array(tracker["reflectors"][reflector]["point"]) + flange[:3, 3]
    out: Array = from_pose6(tracker["T_base_tracker"]).inv().apply(place)
    return out


def _rms(off: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(off)))) if off else 0.0
