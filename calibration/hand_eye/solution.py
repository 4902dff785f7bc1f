"""From measurements in memory to X with its covariance: the one path that everything uses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from calibration.hand_eye import se3
from calibration.hand_eye.ambiguity import candidates, choose
from calibration.hand_eye.noise import Noise
from calibration.hand_eye.noise_limit import fit_within_limits
from calibration.hand_eye.normal import normal, squared_distances
from calibration.hand_eye.observability import refuse
from calibration.hand_eye.pnp import solve_pnp
from calibration.hand_eye.problem import Estimate, Groups, Problem, Setup
from calibration.hand_eye.views import CornerSet
from calibration.refusal import Refusal
from cell.devices import Intrinsics
from cell.poses import Array

_WEAK = 5.0  # times less certain than the median: weighs nothing, and its own pose says nothing
_CHANCE = 1e-3  # of residuals that exceed right noise levels
_BAD_FIT = 4.0  # times the median reprojection error


@dataclass(frozen=True)
class Measurements:
    """n observations in memory.

    ``F`` (n, 4, 4) is T_base_flange; ``views[i]`` the corners, or None where ``C[i]`` (4, 4), the given
    T_camera_target, is the measurement; ``motions`` (k, 4, 4) turn the target onto itself (identity first).
    """

    setup: Setup
    F: Array
    group: Groups
    views: Sequence[CornerSet | None]
    C: Array
    motions: Array


@dataclass(frozen=True)
class Solution:
    """The answer, or why there is none.

    ``problem`` holds all n measurements with the chosen poses, ``used`` (n,) those that X was made of,
    ``reasons`` why a row was left out. ``cov`` (6, 6) belongs to X and ``cov_W`` (g, 6, 6) to the target
    poses, ``at`` covers the groups in ``groups`` (g,). ``excess`` is the square of the factor by which the
    residuals exceed the noise levels; the covariances carry it.
    """

    problem: Problem
    used: NDArray[np.bool_]
    reasons: Mapping[int, str]
    at: Estimate
    groups: Groups
    cov: Array
    cov_W: Array
    noise: Noise
    excess: float
    distance: Array


def prepare(measured: Measurements, camera: Intrinsics | None) -> Problem:
    """PnP with covariance for all views, and the choice between poses that one image leaves open."""
    n = len(measured.F)
    G = measured.F if measured.setup == "eye-to-hand" else se3.inverse(measured.F)
    C, cov, sse, dof = measured.C.copy(), np.zeros((n, 6, 6)), np.zeros(n), np.zeros(n)
    seen = np.array([i for i, v in enumerate(measured.views) if v is not None], dtype=np.int64)
    if len(seen) and camera is not None:
        poses, owner = solve_pnp([v for v in measured.views if v is not None], camera)
        options, rows = candidates(poses, owner, measured.motions)
        chosen = choose(measured.setup, G[seen], measured.group[seen], options)
        k = np.arange(len(seen))
        own = poses.take(rows[k, chosen])
        C[seen], cov[seen] = options[k, chosen], own.cov
        sse[seen], dof[seen] = own.sse, 2 * own.corners - 6
    return Problem(measured.setup, G, C, measured.group, cov, sse, dof)


def solve(
    measured: Measurements, camera: Intrinsics | None, given_noise: Mapping[str, float]
) -> Solution | Refusal:
    """Weighted maximum-likelihood X (docs/methods.md), robust against blunders.

    ``given_noise`` may hold ``sigma_px``, ``sigma_flange_t`` (m) and ``sigma_flange_r`` (rad); absent ones
    are estimated. Every view must have corners enough for a pose; ``camera`` may be None when there are no
    views. A set that cannot determine X is refused.
    """
    problem = prepare(measured, camera)
    reasons = weak_views(problem)
    fit_rows = np.array([i not in reasons for i in range(problem.n)], dtype=bool)
    part = problem.take(fit_rows)
    refusal = refuse(part, given_noise.get("sigma_flange_r", 0.0))
    if refusal is not None:
        return refusal
    fit = fit_within_limits(part, given_noise)
    used = fit_rows.copy()
    used[fit_rows] = fit.used
    if not fit.used.all():
        refusal = refuse(part.take(fit.used), given_noise.get("sigma_flange_r", 0.0))
    if refusal is not None:
        return refusal
    excess = excess_of(fit.lin.r, fit.weight, fit.lin.problem.groups)
    cov = normal(fit.lin, fit.weight).covariance()
    distance = np.full(problem.n, np.nan)
    distance[fit_rows] = fit.distance
    for i in np.flatnonzero(fit_rows & ~used):
        reasons[int(i)] = (
            f"disagrees with the others: its residual is {distance[i]:.1f} times what its noise explains"
        )
    return Solution(
        problem=problem,
        used=used,
        reasons=reasons,
        at=fit.lin.at,
        groups=np.unique(problem.group[used]),
        cov=excess * cov.X,
        cov_W=excess * cov.own[:, 6:, 6:],
        noise=fit.noise,
        excess=excess,
        distance=distance,
    )


def excess_of(r: Array, weight: Array, groups: int) -> float:
    """By which the squares of residuals ``r`` (n, 6) of some ``groups`` exceed what the noise explains, one
    where they do not beyond chance."""
    squared = float(squared_distances(r, weight).sum())
    left = 6 * len(r) - 6 - 6 * groups
    return squared / left if left > 0 and squared > chdtri(left, _CHANCE) else 1.0


def weak_views(problem: Problem) -> dict[int, str]:
    """Rows whose image is too poor to say anything, with the reason."""
    seen = np.flatnonzero(np.any(problem.cov_px, axis=(1, 2)))
    if len(seen) < 4:
        return {}
    reasons: dict[int, str] = {}
    turn = np.sqrt(np.trace(problem.cov_px[seen, 3:, 3:], axis1=1, axis2=2))
    rms = np.sqrt(problem.sse[seen] / (problem.dof[seen] + 6.0))
    ratios, fits = turn / np.median(turn), rms / max(float(np.median(rms)), 0.02)
    for k in np.flatnonzero((ratios > _WEAK) | (fits > _BAD_FIT)):
        i, ratio, fit = seen[k], ratios[k], fits[k]
        if ratio > _WEAK:
            corners = int(problem.dof[i] + 6) // 2
            reasons[int(i)] = (
                f"weak view: with {corners} corners its target pose is {ratio:.1f} times less certain than "
                "the median"
            )
        else:
            reasons[int(i)] = (
                f"corners do not fit the target: {rms[k]:.2f} px RMS, {fit:.1f} times the median"
            )
    return reasons
