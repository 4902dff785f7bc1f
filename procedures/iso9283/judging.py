"""From arrivals to AP and RP: the one path of job and replay."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.identification.registration import Registration, register
from calibration.iso9283 import CYCLES, FORMULA_AP, FORMULA_RP, PoseFigures, drift, figures
from cell.errors import error
from cell.formats.iso9283 import Iso9283
from cell.formats.result import Warning_
from cell.poses import Array, from_pose6
from procedures.iso9283.plan import ORDER
from procedures.iso9283.record import read_data_set
from procedures.iso9283.result import (
    KEYS,
    Arrival,
    Drift,
    Formula,
    Iso9283Answer,
    Iso9283HeldOut,
    Iso9283Inputs,
    Iso9283Observability,
    Iso9283Residuals,
    Iso9283Result,
    Iso9283Uncertainty,
    PoseResult,
    RegistrationUsed,
    TrackerNoise,
)
from procedures.laser_tracker.locating import pose6_of, registration_of
from procedures.solving import within_limits

_STAND_FACTOR, _STAND_M = 3.0, 0.0005  # of what the best place leaves, before the stand is said to have moved
_MANY_LOST = 0.1
_NOT_MEASURED = "attitude accuracy and repeatability: one reflector shows places alone"
_FITTED = (
    "an error that all poses share: the tracker's place was fitted to these poses, so a common shift or turn "
    "of the arm's base is not in AP"
)


@dataclass(frozen=True, eq=False)
class _Arrivals:
    """By pose, (n, 3): places in the tracker frame in the order of the cycles, and the place wanted (3,)."""

    p: dict[str, Array]
    wanted: dict[str, Array]


@within_limits
def solve_iso9283(path: Path, limits: Mapping[str, float | None]) -> Iso9283Result:
    """The result from a data set, judged by ``max_AP_m`` and ``max_RP_m``.

    ``ISO9283_INCOMPLETE`` when a pose has fewer than two arrivals.
    """
    data = read_data_set(path)
    arrivals = _arrivals(data)
    best = _fit(arrivals)
    used = best if data.T_base_tracker is None else registration_of(data.T_base_tracker)
    found = {name: _figures(data, arrivals, used, name) for name in sorted(ORDER)}
    poses = [_entry(name, arrivals.wanted[name], found[name]) for name in found]
    moved = drift([used.to_base(arrivals.p[name].T).T for name in found])
    registration = RegistrationUsed(
        how=data.registration,
        poses=len(arrivals.p),
        T_base_tracker=pose6_of(used),
        rms_m=_rms(used, arrivals),
        rms_best_m=_rms(best, arrivals),
        meaning="distance (m, RMS) of the barycentres from where they were wanted: in the place used, and "
        "in the one that suits them best",
    )
    sigma = max(_sigma(data, arrivals, name) for name in found)
    answer = Iso9283Answer(
        AP={p.name: p.AP for p in poses},
        RP={p.name: p.RP for p in poses},
        AP_max=max(p.AP for p in poses),
        RP_max=max(p.RP for p in poses),
        poses=poses,
        formula=Formula(
            AP=FORMULA_AP,
            RP=FORMULA_RP,
            floor="AP and RP are never given below the tracker's own; the measured values stand beside",
        ),
        tracker=TrackerNoise(
            sigma0=data.noise.sigma0,
            sigma_per_m=data.noise.sigma_per_m,
            sigma_axis_m=sigma,
            AP_95_m=max(f.tracker_AP for f in found.values()),
            RP_m=max(f.tracker_RP for f in found.values()),
            meaning="what a perfect arm would read: 95 % of AP below AP_95_m, RP of RP_m; averaging is "
            "given no credit",
        ),
        corrected=data.corrected,
        kinematics_version=None if data.kinematics is None else data.kinematics.version,
        registration=registration,
        cycles=min(f.count for f in found.values()),
        cycles_wanted=data.cycles,
        reflector=data.reflector,
        point=data.point,
        speed_share=data.speed_share,
        payload_kg=data.payload_kg,
        drift=None
        if moved is None
        else Drift(
            shift_m=moved.shift.tolist(),
            distance_m=float(np.linalg.norm(moved.shift)),
            sigma_m=moved.sigma_m,
            beyond_noise=moved.beyond_noise,
            meaning="how far all poses moved together from the first third of the cycles to the last",
        ),
    )
    reasons = _beyond(poses, limits)
    warnings = _warnings(data, answer)
    return Iso9283Result(
        verdict="fail" if reasons else "warn" if warnings else "pass",
        reasons=[*reasons, *(text for _, text in warnings)],
        warnings=Warning_.each(warnings),
        result=answer,
        uncertainty=Iso9283Uncertainty(
            AP_U={p.name: p.AP_U for p in poses},
            RP_95={p.name: p.RP_95 for p in poses},
            meaning="AP_U: 95 % of the errors of a barycentre stay below this (m), from the tracker's "
            "noise and the scatter; RP_95: where 95 % of the RP of more arrivals would lie (m)",
        ),
        residuals=Iso9283Residuals(per_sample=_per_sample(data, arrivals, used)),
        heldout=Iso9283HeldOut(
            meaning="every arrival is judged; nothing but the tracker's place is taken from them"
        ),
        observability=Iso9283Observability(
            undetermined=[_NOT_MEASURED] + ([_FITTED] if data.registration == "fit" else [])
        ),
        inputs=Iso9283Inputs(
            robot_joints=len(data.poses[0].q),
            samples=len(data.samples),
            rotations=sum(sample.rotation is not None for sample in data.samples),
            corrected=data.corrected,
            payload_kg=data.payload_kg,
        ),
    )


def _arrivals(data: Iso9283) -> _Arrivals:
    by_pose: dict[str, list[list[float]]] = {}
    for sample in sorted(data.samples, key=lambda s: s.cycle):
        by_pose.setdefault(sample.pose, []).append(sample.p_tracker)
    few = [name for name in ORDER if len(by_pose.get(name, ())) < 2]
    if few:
        counts = ", ".join(f"{name} has {len(by_pose.get(name, ()))}" for name in sorted(few))
        raise error("ISO9283_INCOMPLETE", f"{counts} arrivals; two are the least")
    wanted = {
        pose.name: np.asarray(from_pose6(pose.T_base_flange).apply(data.point), dtype=float)
        for pose in data.poses
    }
    return _Arrivals({name: np.array(p) for name, p in by_pose.items()}, wanted)


def _fit(arrivals: _Arrivals) -> Registration:
    """The tracker's place that brings the barycentres closest to where they were wanted."""
    p = np.array([rows.mean(axis=0) for rows in arrivals.p.values()])
    f = np.array([arrivals.wanted[name] for name in arrivals.p])
    return register(p.T, f.T, np.ones(len(p)))


def _rms(place: Registration, arrivals: _Arrivals) -> float:
    p = np.array([rows.mean(axis=0) for rows in arrivals.p.values()])
    f = np.array([arrivals.wanted[name] for name in arrivals.p])
    return float(np.sqrt(np.mean(np.sum((place.to_base(p.T).T - f) ** 2, axis=1))))


def _sigma(data: Iso9283, arrivals: _Arrivals, name: str) -> float:
    """The tracker's standard deviation along one axis at the range of a pose, m."""
    distance = float(np.linalg.norm(arrivals.p[name].mean(axis=0)))
    return float((data.noise.sigma0 or 0.0) + (data.noise.sigma_per_m or 0.0) * distance)


def _figures(data: Iso9283, arrivals: _Arrivals, place: Registration, name: str) -> PoseFigures:
    at = place.to_base(arrivals.p[name].T).T
    return figures(at, arrivals.wanted[name], _sigma(data, arrivals, name))


def _entry(name: str, wanted: Array, found: PoseFigures) -> PoseResult:
    return PoseResult(
        name=name,
        commanded=wanted.tolist(),
        barycentre=found.barycentre.tolist(),
        deviation=found.deviation.tolist(),
        AP=max(found.AP, found.tracker_AP),
        AP_measured=found.AP,
        AP_U=found.AP_U,
        AP_tracker=found.tracker_AP,
        AP_resolved=found.tracker_AP < found.AP,
        RP=max(found.RP, found.tracker_RP),
        RP_measured=found.RP,
        RP_95=found.RP_95 and list(found.RP_95),
        RP_tracker=found.tracker_RP,
        RP_resolved=found.tracker_RP < found.RP,
        mean_distance=found.mean_distance,
        std_distance=found.std_distance,
        cycles=found.count,
    )


def _per_sample(data: Iso9283, arrivals: _Arrivals, place: Registration) -> list[Arrival]:
    """Each arrival in the base, as it is off the barycentre of its pose, m."""
    middle = {name: place.to_base(rows.mean(axis=0)[:, None])[:, 0] for name, rows in arrivals.p.items()}
    out = []
    for sample in data.samples:
        at = place.to_base(np.array(sample.p_tracker)[:, None])[:, 0]
        off = (at - middle[sample.pose]).tolist()
        out.append(Arrival(pose=sample.pose, cycle=sample.cycle, off=off))
    return out


def _beyond(poses: list[PoseResult], limits: Mapping[str, float | None]) -> list[str]:
    reasons = []
    for key in KEYS:
        limit = limits.get(f"max_{key}_m")
        bad = [(p.name, p.figure(key)[0]) for p in poses if limit is not None and p.figure(key)[0] > limit]
        if bad and limit is not None:
            listed = ", ".join(f"{name} {1e3 * value:.3f} mm" for name, value in bad)
            reasons.append(f"max_{key}_m: {key} is {listed}, the limit is {1e3 * limit:g} mm")
    return reasons


def _warnings(data: Iso9283, answer: Iso9283Answer) -> list[tuple[str, str]]:
    out: list[tuple[str, str]] = []
    if answer.cycles < CYCLES:
        text = f"{answer.cycles} cycles were measured; the standard has {CYCLES}"
        out.append(("iso9283.few-cycles", text))
    judged = [s for s in data.samples if s.cycle]
    if len(judged) < (1.0 - _MANY_LOST) * data.cycles * len(ORDER):
        text = f"{len(judged)} of {data.cycles * len(ORDER)} arrivals could be measured"
        out.append(("samples.lost", text))
    if doubtful := [s for s in judged if s.warnings]:
        said = "; ".join(dict.fromkeys(w for s in doubtful for w in s.warnings))
        text = f"at {len(doubtful)} of {len(judged)} arrivals the tracker warned: {said}"
        out.append(("tracker.doubtful", text))
    for key in KEYS:
        bound = [p.name for p in answer.poses if not p.figure(key)[2]]
        if bound:
            text = (
                f"{key} of {', '.join(bound)} is below what the tracker resolves; the tracker's own is given"
            )
            out.append(("iso9283.not-resolved", text))
    moved = answer.drift
    if moved and moved.beyond_noise:
        text = f"all poses moved together by {1e3 * moved.distance_m:.3f} mm during the test"
        out.append(("iso9283.drift", f"{text}: the arm was warming up, or the tracker's stand moved"))
    place = answer.registration
    if place.how == "kinematics" and place.rms_m > max(_STAND_FACTOR * place.rms_best_m, _STAND_M):
        text = (
            f"in the tracker's place of the calibration the poses are {1e3 * place.rms_m:.3f} mm off, in "
            f"the best place {1e3 * place.rms_best_m:.3f} mm: the stand or the base has moved since"
        )
        out.append(("iso9283.stand", text))
    return out
