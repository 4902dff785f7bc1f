"""Pose accuracy and repeatability beside the twin's truth: where its arm truly goes, and how it scatters."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from calibration.identification.registration import Registration, register
from calibration.iso9283 import repeatability_of
from cell.formats.iso9283 import Iso9283
from cell.poses import Array, from_pose6
from procedures.beside_truth import STATED_BEYOND, WRONG_BEYOND, Judged, all_inside, limit_of_worst
from procedures.iso9283.record import DATA_FILE, read_data_set
from procedures.iso9283.result import Iso9283Result, PoseResult
from procedures.laser_tracker.locating import registration_of
from procedures.twin_arm import true_flange
from procedures.words import mm, table


def judge_iso9283(result: Iso9283Result, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Good when each pose's deviation is within its AP_U of the true one, and the true RP within RP_95, by
    limits that ``SURE`` of good runs keep at their worst pose; ``of95`` has the worst by those of 95 %,
    and ``limits95`` the limit of that pose: of AP in m, and of RP, whose interval is longer above than
    below and has no single limit in m, half of it in logarithms, which is nearly a share of RP.

    The true deviation is that of an arm that repeats exactly, seen by a tracker without noise, and with its
    place found as the run found it: a shift that all poses share is in neither. The true RP is the one that
    more and more arrivals would show with this tracker, as RP_95 states it.
    """
    data = read_data_set(folder / DATA_FILE)
    deviations, poses = _true_deviations(data, truth), result.result.poses
    by_name = {p.name: p for p in poses}
    RP = {pose.name: _true_RP(data, truth, pose.name) for pose in poses}
    off = {p.name: float(np.linalg.norm(np.array(p.deviation) - deviations[p.name])) for p in poses}
    shares = {p.name: off[p.name] / p.AP_U for p in poses}
    worst, n = max(shares, key=shares.__getitem__), len(poses)
    of95 = {"the worst AP": shares[worst] / limit_of_worst(n)}
    limits95 = {"the worst AP": (by_name[worst].AP_U * limit_of_worst(n), "m")}
    good = shares[worst] <= limit_of_worst(n, sure=True)
    intervals = {p.name: (_beyond(p, RP[p.name]), p.cycles) for p in poses if p.RP_95 is not None}
    if intervals:
        wider = {name: _worst_of_t(n, cycles, STATED_BEYOND) for name, (_, cycles) in intervals.items()}
        of_RP = {name: share / wider[name] for name, (share, _) in intervals.items()}
        least = max(of_RP, key=of_RP.__getitem__)
        of95["the worst RP"] = of_RP[least]
        limits95["the worst RP"] = (_middle_and_half(by_name[least])[1] * wider[least], "1")
        good = good and all(
            share <= _worst_of_t(n, cycles, WRONG_BEYOND) for share, cycles in intervals.values()
        )
    rows = [
        (
            p.name,
            *map(mm, (p.AP_measured, float(np.linalg.norm(deviations[p.name])), off[p.name], p.AP_U)),
            *map(mm, (p.RP_measured, RP[p.name])),
            _interval(p),
        )
        for p in poses
    ]
    header = ("pose", "AP", "true", "off", "95 %", "RP", "true", "95 %")
    text = [
        "AP and RP as measured, beside the twin's own arm and the noise of its tracker",
        table(header, rows),
        f"{'consistent with' if good else 'NOT consistent with'} what is stated",
    ]
    stated = f"AP {mm(by_name[worst].AP_measured)} +- {mm(by_name[worst].AP_U)} (95 %) at {worst}"
    told = f"deviation {mm(off[worst])}"
    if intervals:
        farthest = max(intervals, key=lambda name: intervals[name][0])
        stated += f", RP {_interval(by_name[farthest])} at {farthest}"
        told += f", RP truly {mm(RP[farthest])}"
    return Judged(good, "\n".join(text), stated, told, all_inside(of95), of95, limits95)


def _true_deviations(data: Iso9283, truth: Mapping[str, Any]) -> dict[str, Array]:
    """By pose, (3,) m in the base: from where the reflector was wanted to where it truly comes."""
    tracker, seen = truth["tracker"], {sample.pose for sample in data.samples}
    poses = [pose for pose in data.poses if pose.name in seen]
    point = np.append(tracker["reflectors"][data.reflector]["point"], 1.0)
    at = (true_flange(truth["robot"], np.array([pose.q for pose in poses])) @ point)[:, :3]
    p = from_pose6(tracker["T_base_tracker"]).inv().apply(at)
    wanted = np.array([from_pose6(pose.T_base_flange).apply(data.point) for pose in poses])
    place: Registration
    if data.T_base_tracker is None:
        place = register(p.T, wanted.T, np.ones(len(p)))
    else:
        place = registration_of(data.T_base_tracker)
    apart = place.to_base(p.T).T - wanted
    return {pose.name: apart[k] for k, pose in enumerate(poses)}


def _true_RP(data: Iso9283, truth: Mapping[str, Any], name: str) -> float:
    """m: of the arm's scatter and what is left of the tracker's noise in the mean of its readings."""
    arm, tracker = truth["noise"], truth["tracker"]
    samples = [sample for sample in data.samples if sample.pose == name]
    away = np.mean([np.linalg.norm(sample.p_tracker) for sample in samples])
    reading = tracker["sigma0_m"] + tracker["sigma_per_m"] * float(away)
    left = np.mean([1.0 / max(sample.count or 1, 1) for sample in samples])
    lever = np.linalg.norm(tracker["reflectors"][data.reflector]["point"])
    turned = 2.0 / 3.0 * (arm["sigma_flange_r"] * lever) ** 2  # across the lever alone
    return repeatability_of(float(np.sqrt(arm["sigma_flange_t"] ** 2 + turned + reading**2 * left)))


def _beyond(pose: PoseResult, RP: float) -> float:
    """How far the true RP is from the middle of the interval, in units of its half, as logarithms."""
    middle, half = _middle_and_half(pose)
    return float(abs(np.log(RP) - middle) / half)


def _middle_and_half(pose: PoseResult) -> tuple[float, float]:
    """Of the interval of RP, as logarithms."""
    low, high = np.log(pose.RP_95 or (pose.RP, pose.RP))
    return float((low + high) / 2.0), float((high - low) / 2.0)


def _worst_of_t(poses: int, cycles: int, beyond: float) -> float:
    """As ``limit_of_worst``, of intervals that go by Student's distribution, as those of RP do."""
    one = stdtrit(cycles - 1, 1.0 - STATED_BEYOND / 2.0)
    return float(stdtrit(cycles - 1, 1.0 - beyond / (2.0 * poses)) / one)


def _interval(pose: PoseResult) -> str:
    return "-" if pose.RP_95 is None else f"{mm(pose.RP_95[0])} to {mm(pose.RP_95[1])}"
