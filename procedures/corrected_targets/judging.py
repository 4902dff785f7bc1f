"""From arrivals to what remained off at each target: the one path of job and replay."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.special import chdtri

from calibration.identification.application import chain_of
from calibration.identification.registration import register
from cell.errors import error
from cell.formats.corrected_targets import Arrival, CorrectedTargets
from cell.formats.result import Warning_
from cell.poses import Array, from_pose6
from procedures.corrected_targets.joint_ranges import OUTSIDE, is_outside, outside_text
from procedures.corrected_targets.plan import place_of
from procedures.corrected_targets.record import read_data_set
from procedures.corrected_targets.result import (
    Reached,
    TargetResult,
    TargetsAnswer,
    TargetsInputs,
    TargetsObservability,
    TargetsResult,
    TargetsUncertainty,
    Together,
)
from procedures.laser_tracker.locating import registration_of
from procedures.solving import within_limits
from procedures.words import mm

_RADIUS95 = float(np.sqrt(chdtri(3, 0.05)))  # of a normal 3-vector, in its standard deviation of an axis
_LEAST_FOR_STAND = 4  # fewer points fit any place of the tracker well
_STAND_FACTOR, _STAND_M = 3.0, 0.0005  # of what the best place leaves, before the stand is said to have moved
_PLACES_ALONE = "heading and tilt: one reflector shows places alone"
_MODEL_ALONE = "errors of the calibrated arm itself: no tracker looked where it truly went"


@within_limits
def solve_targets(path: Path, max_error_m: float | None) -> TargetsResult:
    """The result from a data set; ``TARGETS_INCOMPLETE`` where no corrected target was measured."""
    data = read_data_set(path)
    if not any(a.how == "corrected" for a in data.arrivals):
        raise error("TARGETS_INCOMPLETE", f"of {len(data.targets)} targets none was measured as corrected")
    reached = {(a.target, a.how): _reached(data, a) for a in data.arrivals}
    targets = [
        TargetResult(
            number=k + 1,
            T_base_flange=target.T_base_flange,
            command=target.command,
            q=target.corrected,
            before=reached.get((k, "given")),
            after=reached.get((k, "corrected")),
        )
        for k, target in enumerate(data.targets)
    ]
    after = [t.after for t in targets if t.after is not None]
    before = [t.before for t in targets if t.before is not None]
    stated = [r.error_95_m for r in after if r.error_95_m is not None]
    largest = max(stated) if len(stated) == len(after) else None
    outside = _outside(data)
    answer = TargetsAnswer(
        targets=targets,
        before=_together(before) if before else None,
        after=_together(after),
        seen_by="joints" if data.reflector is None else "tracker",
        reflector=data.reflector,
        arm=data.arm,
        kinematics_version=data.kinematics_version,
    )
    found = TargetsResult(
        verdict="pass",
        result=answer,
        uncertainty=TargetsUncertainty(
            error_95_m=largest,
            predicted_95_m=data.predicted_95,
            meaning=_meaning(data) + (f". predicted_95_m: {outside}" if outside else ""),
        ),
        observability=TargetsObservability(
            undetermined=[_MODEL_ALONE if data.reflector is None else _PLACES_ALONE]
        ),
        inputs=TargetsInputs(targets=len(data.targets), arrivals=len(data.arrivals)),
    )
    warnings = _warnings(data, answer, max_error_m)
    if outside:
        warnings.append((OUTSIDE, outside))
    judged = found.judged(_beyond(targets, max_error_m), Warning_.each(warnings))
    return judged.changed(reasons=[*judged.reasons, *(text for _, text in warnings)])


def _reached(data: CorrectedTargets, arrival: Arrival) -> Reached:
    """One arrival against its target. Wanted is the place of the reflector with the flange at the target."""
    target, q = data.targets[arrival.target], np.array(arrival.q)
    asked = np.array(target.given if arrival.how == "given" else target.corrected)
    if q.shape != asked.shape:
        raise error("DATA_INVALID", f"an arrival has {q.size} joints; its target has {asked.size}")
    point = place_of(data.robot, data.reflector)
    wanted = from_pose6(target.T_base_flange).apply(point)
    T = chain_of(data.robot).flange(q[None])[0]
    by_joints = T[:3, :3] @ point + T[:3, 3] - wanted
    # How uncertain an extrapolation is has not been stated.
    off, bound = by_joints, None if is_outside(q, _sampled(data)) else data.predicted_95
    if arrival.p_tracker is not None and data.T_base_tracker is not None and data.noise is not None:
        p = np.array(arrival.p_tracker)
        off = from_pose6(data.T_base_tracker).apply(p) - wanted
        sigma = (data.noise.sigma0 or 0.0) + (data.noise.sigma_per_m or 0.0) * float(np.linalg.norm(p))
        bound = _RADIUS95 * sigma
    return Reached(
        q=arrival.q,
        off_rad=float(np.max(np.abs(q - asked))),
        error_m=float(np.linalg.norm(off)),
        error=[float(v) for v in off],
        error_95_m=bound,
        by_joints_m=float(np.linalg.norm(by_joints)),
    )


def _sampled(data: CorrectedTargets) -> Array | None:
    return None if data.joints_sampled_rad is None else np.array(data.joints_sampled_rad)


def _outside(data: CorrectedTargets) -> str | None:
    """Which corrected arrivals rested where the calibration has not sampled."""
    rows = [a for a in data.arrivals if a.how == "corrected"]
    return outside_text(np.array([a.q for a in rows]), [a.target + 1 for a in rows], _sampled(data))


def _together(found: Sequence[Reached]) -> Together:
    off = np.array([r.error_m for r in found])
    return Together(targets=len(off), rms_m=float(np.sqrt(np.mean(off**2))), max_m=float(off.max()))


def _meaning(data: CorrectedTargets) -> str:
    if data.reflector is None:
        return (
            "error_95_m: 95 % of the prediction errors of the calibrated arm stay below this (m), as its "
            "calibration states them; no tracker looked"
        )
    return (
        "error_95_m: 95 % of the tracker's own errors at the range of a target stay below this (m); "
        "averaging is given no credit. Places are in the base as the calibration has it, with the tracker "
        "where it stood then"
    )


def _beyond(targets: Sequence[TargetResult], limit: float | None) -> list[str]:
    if limit is None:
        return []
    return [
        f"max_error_m: target {t.number} is {mm(t.after.error_m)} off, the limit is {mm(limit)}"
        for t in targets
        if t.after is not None and t.after.error_m > limit
    ]


def _warnings(data: CorrectedTargets, answer: TargetsAnswer, limit: float | None) -> list[tuple[str, str]]:
    out: list[tuple[str, str]] = []
    pairs = [(t.before, t.after) for t in answer.targets]
    after = [found for _, found in pairs if found is not None]
    if limit is not None and (
        near := [r for r in after if r.error_m <= limit < r.error_m + (r.error_95_m or 0.0)]
    ):
        text = f"{len(near)} targets are within {mm(limit)}, but not by more than their uncertainty"
        out.append(("targets.limit-open", text))
    if both := [(b, a) for b, a in pairs if b is not None and a is not None]:
        before_rms, after_rms = (_together(found).rms_m for found in zip(*both, strict=True))
        if after_rms >= before_rms:
            text = f"corrected targets are {mm(after_rms)} off (RMS), as given {mm(before_rms)}"
            out.append(("targets.not-better", f"{text}: the correction is of no use here"))
    if far := sum(r.off_rad > data.pose_tolerance_rad for pair in pairs for r in pair if r is not None):
        text = f"at {far} of {len(data.arrivals)} arrivals the arm rested elsewhere than was asked"
        out.append(("targets.off-plan", f"{text}, by more than pose_tolerance_rad"))
    wanted = len(data.targets) * (2 if data.as_given else 1)
    if len(data.arrivals) < wanted:
        out.append(("targets.lost", f"{len(data.arrivals)} of {wanted} arrivals could be measured"))
    if (text_of_stand := _stand(data)) is not None:
        out.append(("targets.stand", text_of_stand))
    if said := sorted({w for a in data.arrivals for w in a.warnings}):
        out.append(("tracker.doubtful", f"the tracker warned: {'; '.join(said)}"))
    return out


def _stand(data: CorrectedTargets) -> str | None:
    """That another place of the tracker fits the readings far better: somebody has moved its stand."""
    rows = [a for a in data.arrivals if a.p_tracker is not None]
    if data.T_base_tracker is None or len(rows) < _LEAST_FOR_STAND:
        return None
    point, chain = place_of(data.robot, data.reflector), chain_of(data.robot)
    T = chain.flange(np.array([a.q for a in rows]))
    f: Array = (T[:, :3, :3] @ point + T[:, :3, 3]).T
    p = np.array([a.p_tracker for a in rows], dtype=float).T
    used, best = (
        float(np.sqrt(np.mean(np.sum((place.to_tracker(f) - p) ** 2, axis=0))))
        for place in (registration_of(data.T_base_tracker), register(p, f, np.ones(len(rows))))
    )
    if used < _STAND_M or used < _STAND_FACTOR * best:
        return None
    return (
        f"readings are {mm(used)} off the calibrated arm (RMS), and {mm(best)} with the tracker elsewhere: "
        "its stand has been moved since the calibration; run tracker-sampling again"
    )
