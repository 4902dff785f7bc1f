"""The result of a hand-eye solution: every figure with its name, in the form of docs/data-sets.md."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.classic import METHODS, solve_classic
from calibration.hand_eye.leave_out import (
    LeftOut,
    by_placement,
    held_out,
    leave_one_out,
    pose_distances,
    spread_about_mean,
)
from calibration.hand_eye.noise import MOST, perfect_arm_variances, weights
from calibration.hand_eye.normal import Linearised, linearise
from calibration.hand_eye.observability import axes_frame, rotations, still_pairs
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import Measurements, Solution
from calibration.hand_eye.spread import PlacementEstimates, placements, spread_across, spread_within
from calibration.hand_eye.spread import Spread as ResolvedSpread
from calibration.hand_eye.views import ideal_corners
from cell.formats.result import Rejected, Warning_
from cell.poses import Array, to_pose6
from procedures.hand_eye.result import (
    CrossCheck,
    HandEyeAnswer,
    HandEyeHeldOut,
    HandEyeInputs,
    HandEyeObservability,
    HandEyeResiduals,
    HandEyeResult,
    HandEyeUncertainty,
    ObservationResidual,
)
from procedures.hand_eye.result_spread import BaseSpread, Distance, Estimates, Spread, TwoSpreads
from procedures.hand_eye.result_spread import LeftOut as MeanLeftOut
from procedures.hand_eye.solve.camera import CameraChoice
from procedures.hand_eye.solve.capture import CaptureSet
from procedures.hand_eye.solve.neighbours import Neighbours
from procedures.words import listed

_CROSS_CHECK_POSES = 60  # OpenCV's solvers take the square of this many pairs
_MANY_REJECTED = 0.25
REPROJECTION = "arm.reprojection"
_MOST_RATIO = 10.0  # an arm in working order has 2 to 5
_LEAST_PX = 0.05


@dataclass(frozen=True)
class Adjustment:
    """What method ``adjustment`` adds: ``answer`` and ``uncertainty`` are entries of those tables."""

    answer: dict[str, Any]
    uncertainty: dict[str, Any]


@dataclass(frozen=True)
class Solved:
    """Everything that the result is written from. ``rows`` are the usable observations; ``judged`` is what
    residuals, held-out figures and spreads are made by."""

    loaded: CaptureSet
    rows: NDArray[np.int64]
    measured: Measurements
    camera: CameraChoice
    solution: Solution
    judged: Solution
    cov: Array | None
    method: str
    warnings: list[tuple[str, str]]
    inputs: dict[str, Any]
    neighbours: Neighbours
    adjustment: Adjustment | None = None

    @cached_property
    def through_arm(self) -> Array:
        """RMS distance (n,) in pixels of the corners from where arm, X and target put them; NaN without."""
        return _through_arm(self)


def fill_result(solved: Solved) -> HandEyeResult:
    """The whole result; the verdict is ``warn`` when anything is to be warned of."""
    solution = solved.judged
    part = solution.problem.take(solution.used)
    lin = linearise(part, solution.at)
    P = weights(lin, solution.noise)
    warnings = solved.warnings + _warnings(solved)
    return HandEyeResult(
        verdict="warn" if warnings else "pass",
        reasons=[text for _, text in warnings],
        warnings=Warning_.each(warnings),
        result=HandEyeAnswer.model_validate(_answer(solved, lin, P)),
        uncertainty=_uncertainty(solved),
        residuals=_residuals(solved, lin, P),
        heldout=_held_out(solved, lin, P),
        observability=_observability(solved, part),
        inputs=HandEyeInputs(**solved.inputs, used=int(solution.used.sum()), groups=len(solution.groups)),
    )


def names(setup: str) -> tuple[str, str, str]:
    """Name of X, of the target poses, and X in words."""
    if setup == "eye-in-hand":
        return "T_flange_camera", "T_base_target", "camera in flange"
    return "T_base_camera", "T_flange_target", "camera in base"


def pose6(T: Array) -> list[float]:
    """A pose as it is written in files."""
    return [float(v) for v in to_pose6(se3.transforms(T))]


def _answer(solved: Solved, lin: Linearised, P: Array) -> dict[str, Any]:
    solution = solved.solution
    X, W, words = names(solution.problem.setup)
    labels = _labels(solved)
    found = _estimates_of_placements(solved.judged, lin, P)
    two = _two_spreads(found)
    answer: dict[str, Any] = {
        X: pose6(solution.at.X),
        "direction": words,
        W: {labels[int(g)]: pose6(T) for g, T in zip(solution.groups, solution.at.W, strict=True)},
        "cov": None if solved.cov is None else solved.cov.tolist(),
        "rejected": _rejected(solved),
        "spread_within": two.spread_within,
        "spread_across": two.spread_across,
        "spread_by_base": _by_base(solved, found),
        "neighbour_spread": solved.neighbours.spread(),
        "estimates": {labels[int(solution.groups[p.group])]: _estimates(p) for p in found},
        "noise": solution.noise.as_dict(),
    }
    if solved.camera.estimated is not None:
        answer["intrinsics"] = solved.camera.estimated
    return answer if solved.adjustment is None else answer | solved.adjustment.answer


def spreads(solution: Solution) -> TwoSpreads:
    """``spread_within`` and ``spread_across`` of a solution."""
    lin = linearise(solution.problem.take(solution.used), solution.at)
    return _two_spreads(_estimates_of_placements(solution, lin, weights(lin, solution.noise)))


def _estimates_of_placements(solution: Solution, lin: Linearised, P: Array) -> list[PlacementEstimates]:
    return placements(lin.problem, lin.at, P, perfect_arm_variances(lin, solution.noise))


def _two_spreads(found: list[PlacementEstimates]) -> TwoSpreads:
    within, across = spread_within(found), spread_across(found)
    return TwoSpreads(
        spread_within=_spread(within),
        spread_across=_spread(across),
    )


def _spread(found: ResolvedSpread | None) -> Spread | None:
    if found is None:
        return None
    return Spread(
        t=found.t.tolist(),
        t_norm=found.t_norm,
        r=found.r,
        floor_t=found.floor_t if found.floor_known else None,
        floor_r=found.floor_r if found.floor_known else None,
        resolved=found.resolved if found.floor_known else None,
    )


def _by_base(solved: Solved, found: list[PlacementEstimates]) -> dict[str, BaseSpread] | None:
    """The two spreads of the placements at each place of the target's stand, where places are told apart."""
    base = {o.group: o.base for o in solved.loaded.capture.observations if o.base is not None}
    labels = _labels(solved)
    at = [base.get(int(labels[int(solved.solution.groups[p.group])])) for p in found]
    out: dict[str, BaseSpread] = {}
    for b in sorted({b for b in at if b is not None}):
        part = [p for p, where in zip(found, at, strict=True) if where == b]
        both = _two_spreads(part)
        out[str(b)] = BaseSpread(within=both.spread_within, across=both.spread_across)
    return out or None


def _labels(solved: Solved) -> dict[int, str]:
    """The data set's own number of each group."""
    return {int(k): str(g) for k, g in enumerate(np.unique(solved.loaded.group[solved.rows]))}


def _estimates(placement: PlacementEstimates) -> Estimates:
    least = placement.least_squares
    return Estimates(
        mean=pose6(se3.mean_pose(placement.X)) if len(placement.X) else None,
        least_squares=None if least is None else pose6(least),
        triples=len(placement.X),
        skipped=placement.skipped,
    )


def _rejected(solved: Solved) -> list[Rejected]:
    index = solved.loaded.indices
    reasons = dict(solved.loaded.unusable)
    reasons |= {int(solved.rows[k]): text for k, text in solved.solution.reasons.items()}
    return [Rejected(index=index[k], reason=reasons[k]) for k in sorted(reasons)]


def _uncertainty(solved: Solved) -> HandEyeUncertainty:
    cov = solved.cov
    if cov is None:
        return HandEyeUncertainty(meaning=f"method {solved.method} gave no covariance for these data")
    sigma = np.sqrt(np.maximum(np.diag(cov), 0.0))
    labels = _labels(solved)
    solution = solved.solution
    more = {} if solved.adjustment is None else solved.adjustment.uncertainty
    return HandEyeUncertainty(
        cov=cov.tolist(),
        sigma_t=sigma[:3].tolist(),
        sigma_r=sigma[3:].tolist(),
        sigma_t_norm=float(np.linalg.norm(sigma[:3])),
        sigma_r_norm=float(np.linalg.norm(sigma[3:])),
        cov_targets={
            labels[int(g)]: c.tolist() for g, c in zip(solution.groups, solution.cov_W, strict=True)
        },
        excess=solution.excess,
        **more,
        meaning="covariance of a perturbation on the right, translation (m) first, one standard deviation",
    )


def _residuals(solved: Solved, lin: Linearised, P: Array) -> HandEyeResiduals:
    solution, problem = solved.judged, solved.judged.problem
    used = solution.used
    own = problem.target_poses(solution.at.X)
    t_all, r_all = spread_about_mean(own, problem.group)
    t, r = spread_about_mean(own[used], problem.group[used])
    px = np.sqrt(problem.sse / np.maximum((problem.dof + 6.0) / 2.0, 1.0))
    seen = used & (problem.dof > -6.0) & np.any(problem.cov_px, axis=(1, 2))
    through = solved.through_arm
    corners = (problem.dof + 6.0) / 2.0
    index = solved.loaded.indices
    return HandEyeResiduals(
        spread_mean_all=Distance(t=float(t_all.mean()), r=float(r_all.mean())),
        spread_mean=Distance(t=float(t.mean()), r=float(r.mean())),
        loo_mean=MeanLeftOut(**leave_one_out(lin, P).means()),
        reprojection_rms_px=(
            float(np.sqrt(np.sum(problem.sse[seen]) / np.sum(corners[seen]))) if seen.any() else None
        ),
        reprojection_through_arm_rms_px=(
            float(np.sqrt(np.average(through[seen] ** 2, weights=corners[seen]))) if seen.any() else None
        ),
        per_observation=[
            ObservationResidual(
                index=index[int(row)],
                group=int(solved.loaded.group[row]),
                used=bool(used[k]),
                t=float(t_all[k]),
                r=float(r_all[k]),
                reprojection_px=None if solved.measured.views[k] is None else float(px[k]),
                through_arm_px=None if np.isnan(through[k]) else float(through[k]),
                corners=None if solved.measured.views[k] is None else round(float(corners[k])),
                distance=None if np.isnan(solution.distance[k]) else float(solution.distance[k]),
            )
            for k, row in enumerate(solved.rows)
        ],
        cross_check=_cross_check(solved.solution),
    )


def _held_out(solved: Solved, lin: Linearised, P: Array) -> HandEyeHeldOut:
    left_out, placement = held_out(lin, P), by_placement(lin, P)
    problem, at = solved.judged.problem, solved.judged.at
    known = np.isin(problem.group, solved.judged.groups)
    rows = np.flatnonzero(~solved.judged.used & known)  # no solution saw these
    W = at.W[np.searchsorted(solved.judged.groups, problem.group[rows])]
    t, r = pose_distances(problem.target_poses(at.X)[rows], W)
    every = LeftOut(
        np.concatenate([left_out.rows, rows]),
        np.concatenate([left_out.t, t]),
        np.concatenate([left_out.r, r]),
    )
    held = _found_from_all(solved)
    meaning = (
        "target pose seen by observations that the solution did not use, against its own; by "
        "placement: against the others of its placement, which the solution did not use at all"
    )
    if held:
        meaning += f"; {listed(held)} as found from all observations, those that are judged among them"
    return HandEyeHeldOut(
        folds=5,
        from_all=held or None,
        observations=len(left_out.rows),
        mean=MeanLeftOut(**left_out.means()),
        rms=MeanLeftOut(**left_out.rms()),
        rejected=len(rows),
        rms_with_rejected=MeanLeftOut(**every.rms()),
        rms_by_placement=MeanLeftOut(**placement.rms()),
        meaning=meaning,
    )


def _found_from_all(solved: Solved) -> list[str]:
    """The parts of the cell that were found from all observations, and stay as they are when some are left
    out."""
    if solved.adjustment is None:
        return [] if solved.camera.estimated is None else ["lens"]
    return [*(["arm"] if solved.judged is solved.solution else []), "lens", "target"]


def _through_arm(solved: Solved) -> Array:
    solution, camera = solved.judged, solved.camera.camera
    out = np.full(solution.problem.n, np.nan)
    seen = [(k, v) for k, v in enumerate(solved.measured.views) if v is not None]
    if camera is None:
        return out
    place = {int(g): k for k, g in enumerate(solution.groups)}
    for (k, view), ideal in zip(seen, ideal_corners([v for _, v in seen], camera), strict=True):
        g = int(solution.problem.group[k])
        if g not in place:
            continue
        C = se3.inverse(solution.at.X) @ solution.problem.G[k] @ solution.at.W[place[g]]
        turned = C @ solved.measured.motions  # one of them is how this image numbered the points
        p = view.points @ np.swapaxes(turned[:, :3, :3], 1, 2) + turned[:, None, :3, 3]
        if np.any(p[..., 2] <= 0.0):
            continue
        off = (p[..., :2] / p[..., 2:] - ideal) * np.array(camera.K[:2])
        out[k] = float(np.sqrt(np.min(np.mean(np.sum(off**2, axis=2), axis=1))))
    return out


def _cross_check(solution: Solution) -> dict[str, CrossCheck | None]:
    """X of OpenCV's solvers beside ours: their distance, and the spread of the target that they leave."""
    part = _thinned(solution.problem.take(solution.used))
    out: dict[str, CrossCheck | None] = {}
    for method in METHODS:
        X = solve_classic(part, method)
        if X is None:
            out[method] = None
            continue
        dt, dr = pose_distances(X[None], solution.at.X)
        t, r = spread_about_mean(part.target_poses(X), part.group)
        out[method] = CrossCheck(
            pose=pose6(X),
            from_ours=Distance(t=float(dt[0]), r=float(dr[0])),
            spread_mean=Distance(t=float(t.mean()), r=float(r.mean())),
        )
    return out


def _thinned(problem: Problem) -> Problem:
    """At most 60 observations of the largest group."""
    rows = np.flatnonzero(problem.group == int(np.argmax(np.bincount(problem.group))))
    if len(rows) > _CROSS_CHECK_POSES:
        rows = rows[np.linspace(0, len(rows) - 1, _CROSS_CHECK_POSES).round().astype(int)]
    return problem.take(rows)


def _observability(solved: Solved, part: Problem) -> HandEyeObservability:
    turned = rotations(part)
    return HandEyeObservability(
        rotation_rms_rad=turned.rms.tolist(),
        rotation_axes=turned.axes.T.tolist(),
        axes_frame=axes_frame(part.setup),
        unobservable=[],
        weakest=(
            "translation along the axis of the widest rotation (about the second axis the arm turned by "
            f"{np.degrees(turned.rms[1]):.1f} deg RMS)"
        ),
        ambiguity=(
            "the target frame may be turned by a symmetry of the target; X does not depend on it"
            if len(solved.loaded.target.symmetries) > 1
            else None
        ),
    )


def _warnings(solved: Solved) -> list[tuple[str, str]]:
    out = []
    index = [solved.loaded.indices[int(r)] for r in solved.rows]
    still = still_pairs(solved.judged.problem)
    if still:
        text = ", ".join(f"{index[i]}-{index[j]} ({np.degrees(a):.2f} deg)" for i, j, a in still[:8])
        more = f" and {len(still) - 8} more" if len(still) > 8 else ""
        out.append(("pairs.no-rotation", f"consecutive observations without rotation: {text}{more}"))
    noise = solved.solution.noise
    for name in noise.implausible:
        how = (
            "it was held there, which predicts left-out poses better, and the covariance is widened instead"
            if name in noise.most
            else f"{noise.sigma[name]:.2g} is in use, which predicts left-out poses better"
        )
        out.append(
            (
                "noise.at-limit",
                f"the residuals ask for a {name} beyond what an arm in working order has ({MOST[name]:g}): "
                f"look for a bending bracket, a loose target or a wrong lens model; {how}",
            )
        )
    out += _arm_warning(solved)
    total, used = len(solved.loaded.F), int(solved.judged.used.sum())
    if total - used > _MANY_REJECTED * total:
        out.append(("observations.rejected", f"{total - used} of {total} observations were not used"))
    if solved.judged.excess > 1.0 and not noise.implausible:
        factor = float(np.sqrt(solved.judged.excess))
        given = len(solved.judged.noise.estimated) < len(solved.judged.noise.sigma)
        what = "the given noise" if given else "noise"
        out.append(("noise.too-small", f"the residuals are {factor:.1f} times what {what} explains"))
    return out


def _arm_warning(solved: Solved) -> list[tuple[str, str]]:
    """Where corners fit their images and are far from where the arm puts them."""
    through, used = solved.through_arm, solved.judged.used
    problem = solved.judged.problem
    seen = used & np.isfinite(through) & (problem.dof > 0.0)
    if not seen.any():
        return []
    own = np.sqrt(problem.sse[seen] / problem.dof[seen] * 2.0)
    ratio = float(np.median(through[seen]) / max(float(np.median(own)), _LEAST_PX))
    if ratio <= _MOST_RATIO:
        return []
    text = (
        f"corners are {ratio:.0f} times as far from where the arm puts them as the images alone ask for: "
        "look for an arm that still moved, a loose target or camera, or wrong kinematics"
    )
    return [(REPROJECTION, text)]
