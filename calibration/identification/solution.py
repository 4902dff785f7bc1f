"""From readings in memory to parameters with their covariance: the one path that everything uses."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform
from scipy.special import fdtri

from calibration.identification.estimator import Fit, Problem, fit, state_at
from calibration.identification.joint_errors import with_joint_errors
from calibration.identification.label_swap import reads_like
from calibration.identification.model import Model
from calibration.identification.noise import TrackerNoise, excess, first_noise
from calibration.identification.registration import Registration, robust_register
from calibration.identification.robust import RobustFit, robust_fit
from calibration.kinematics.families import optional_numbers, with_optional
from cell.poses import Array

_FAR_OFF = 10.0  # times the median distance: weighs less from the start
_CHANCE = 1e-5  # of taking in a number that the arm does not have
_TOOL_ITERATIONS = 30


@dataclass(frozen=True, eq=False)
class Solution:
    """An arm and a tracker's place. ``x`` (p,) are the parameters of ``problem.model``.

    ``cov`` (p + 6, p + 6) covers the parameters and the registration (a turn and a shift in the base), None
    where a method has none. ``used`` (n,) readings made it, ``reasons`` say why others did not. ``e`` (3, n)
    are residuals in the base, ``distance`` (n,) what they are in units of chance. ``excess`` is the square of
    the factor by which the residuals exceed the noise levels; the covariance carries it. ``constant_m`` was
    found of the reflector's constant and taken out of the readings, ``constant_sigma_m`` is what stays open;
    without that ``cov`` would be ``cov_constant_known`` (None: it is).
    """

    problem: Problem
    x: Array
    registration: Registration
    cov: Array | None
    used: NDArray[np.bool_]
    reasons: Mapping[int, str]
    noise: TrackerNoise
    excess: float
    e: Array
    distance: Array
    unknowns: float
    constant_m: float = 0.0
    constant_sigma_m: float = 0.0
    cov_constant_known: Array | None = None

    @property
    def model(self) -> Model:
        return self.problem.model

    @property
    def freedom(self) -> float:
        """Degrees of freedom that the size of ``cov`` was estimated with; infinite where the noise was given
        and explains the residuals."""
        if self.noise.given and self.excess == 1.0:
            return np.inf
        return max(3.0 * int(self.used.sum()) - self.unknowns, 1.0)

    @property
    def T_tracker_base(self) -> RigidTransform:
        return self.registration.pose()

    def predict(self, Q: Array, target: int = 0) -> tuple[Array, Array | None]:
        """Places (n, 3) of a reflector in the tracker frame for joints ``Q`` (n, j), and their covariances
        (n, 3, 3), m and m^2. ``target`` is a position in ``model.targets``."""
        return predict(self.model, self.x, self.registration, self.cov, Q, target)


def predict(
    model: Model, x: Array, registration: Registration, cov: Array | None, Q: Array, target: int
) -> tuple[Array, Array | None]:
    """See :meth:`Solution.predict`."""
    f, J = model.linearised(x, Q, np.full(len(Q), target, dtype=np.int64))
    p = registration.to_tracker(f).T
    if cov is None:
        return p, None
    R = registration.R
    return p, R @ base_covariance(cov, J) @ R.T


def base_covariance(cov: Array, J: Array) -> Array:
    """(n, 3, 3): covariance in the base of places with derivatives ``J`` (p + 6, 3, n)."""
    CJ = (cov @ J.reshape(len(J), -1)).reshape(J.shape)
    out: Array = np.einsum("kan,kbn->nab", J, CJ)
    return out


def identify(problem: Problem, given_noise: Mapping[str, float], joint_errors: bool = False) -> Solution:
    """Weighted maximum likelihood by variable projection, robust against blunders.

    ``given_noise`` may hold ``sigma0`` (m) and ``sigma_per_m``; absent ones are estimated. What the readings
    cannot determine stays near the prior. ``joint_errors``: those of gears and sag are unknowns as well, as
    far as the readings show them.
    """
    found = robust_fit(problem, given_noise, start_fit(problem, given_noise))
    wider = _with_needed_numbers(problem, found)
    if wider is not None:
        problem, start = wider
        found = robust_fit(
            problem, given_noise, fit(problem, start, found.noise.sigma(problem.range_m) ** -2.0)
        )
    more = with_joint_errors(problem, found, given_noise) if joint_errors else None
    return _solution(*(more or (problem, found)))


def start_fit(problem: Problem, given_noise: Mapping[str, float]) -> Fit:
    """A first solution from the nominal arm; readings that are far off anyhow weigh little.

    Targets without a given place get theirs first: an arm that is off by a tool's length is far from linear.
    """
    model, x = problem.model, problem.model.nominal
    weight = first_noise(given_noise).sigma(problem.range_m) ** -2.0
    if model.unknown_tools:
        rows = model.tool_rows().reshape(-1, 3)
        free = np.concatenate([rows[model.targets.index(name)] for name in model.unknown_tools])
        x = fit(problem, x, weight, iterations=_TOOL_ITERATIONS, free=free).x
    now = state_at(problem, x, weight)
    place = robust_register(problem.p, now.f, weight)
    distance = np.sqrt(np.sum((place.to_tracker(now.f) - problem.p) ** 2, axis=0))
    typical = max(float(np.median(distance)), 1e-9)
    if distance.max() > _FAR_OFF * typical:
        weight = weight * np.minimum(1.0, (2.0 * typical / np.maximum(distance, 1e-12)) ** 2)
    return fit(problem, now, weight)


def _solution(problem: Problem, found: RobustFit) -> Solution:
    now, used = found.fit, found.used
    sigma = found.noise.sigma(problem.range_m)
    factor = excess(now.e[:, used], sigma[used], found.unknowns)
    return Solution(
        problem=problem,
        x=now.x,
        registration=now.registration,
        cov=now.covariance(problem.model, factor),
        used=used,
        reasons=_reasons(problem, found),
        noise=found.noise,
        excess=factor,
        e=now.e,
        distance=found.distance,
        unknowns=found.unknowns,
    )


def _reasons(problem: Problem, found: RobustFit) -> dict[int, str]:
    out = {}
    for i in np.flatnonzero(~found.used):
        off = 1e3 * float(np.linalg.norm(found.fit.e[:, i]))
        like = reads_like(problem, found.fit, int(i))
        out[int(i)] = (
            f"disagrees with the others by {off:.3f} mm, {found.distance[i]:.1f} times what chance explains"
            f"{'' if like is None else f'; it fits reflector {like} instead'}"
        )
    return out


def _with_needed_numbers(problem: Problem, found: RobustFit) -> tuple[Problem, Array] | None:
    """The problem with numbers that the robot's table leaves fixed but the residuals ask for; None mostly.

    A score test: what the sum of squares would lose, without solving again, against what chance takes away.
    """
    model, now = problem.model, found.fit
    betas, ratios = optional_numbers(model.arm)
    if model.arm.family != "serial" or not (betas or ratios):
        return None
    needs_betas = bool(betas) and _asked_for(problem, found, betas, [])
    needs_ratios = bool(ratios) and _asked_for(problem, found, [], ratios)
    if not (needs_betas or needs_ratios):
        return None
    return _extended(problem, now.x, betas if needs_betas else [], ratios if needs_ratios else [])


def _extended(
    problem: Problem, x: Array, betas: list[int], ratios: list[tuple[int, int]]
) -> tuple[Problem, Array]:
    """The problem with more parameters, and ``x`` for it."""
    model = problem.model
    own = len(model.arm.names)
    arm = with_optional(model.arm, betas, ratios)
    old = {name: k for k, name in enumerate(model.names)}
    sd = dict(zip(model.names, model.sd, strict=True))
    angle = float(np.median([s for s, kind in zip(model.sd, model.kinds, strict=True) if kind == "angle"]))
    fresh = [
        angle if kind == "angle" else 0.02 * max(abs(v), 1e-6)
        for kind, v in zip(arm.kinds, arm.nominal, strict=True)
    ]
    wider = replace(
        model,
        arm=arm,
        names=(*arm.names, *model.names[own:]),
        kinds=(*arm.kinds, *model.kinds[own:]),
        nominal=np.concatenate([arm.nominal, model.nominal[own:]]),
        sd=np.concatenate([[sd.get(n, f) for n, f in zip(arm.names, fresh, strict=True)], model.sd[own:]]),
    )
    start = np.array([x[old[n]] if n in old else wider.nominal[k] for k, n in enumerate(wider.names)])
    return replace(problem, model=wider), start


def _asked_for(problem: Problem, found: RobustFit, betas: list[int], ratios: list[tuple[int, int]]) -> bool:
    now = found.fit
    wider, start = _extended(problem, now.x, betas, ratios)
    new = [k for k, n in enumerate(wider.model.names) if n not in problem.model.names]
    _, J = wider.model.linearised(start, problem.Q, problem.target)
    G = (J[new] * np.sqrt(now.weight)).reshape(len(new), -1)
    A = (now.J * np.sqrt(now.weight)).reshape(len(now.J), -1)
    r = (now.e * np.sqrt(now.weight)).ravel()
    G = G - (G @ A.T) @ now.covariance(problem.model) @ A
    S = G @ G.T
    gain = float((G @ r) @ np.linalg.pinv(S, rcond=1e-8, hermitian=True) @ (G @ r))
    left = 3 * int(np.count_nonzero(now.weight)) - found.unknowns - len(new)
    if left < 3:
        return False
    rest = max(float(r @ r) - gain, 1e-12)
    return gain / len(new) / (rest / left) > float(fdtri(len(new), left, 1.0 - _CHANCE))
