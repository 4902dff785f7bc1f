"""Errors of gears and sag as unknowns, as large as the readings say that they are.

Each kind has one standard deviation. It and the size of the noise are variance components of the problem,
linear around the geometric solution, at the maximum of their restricted likelihood. A kind is in the solution
where that likelihood says so.
Source: Patterson and Thompson 1971; the updates are those of MacKay 1992.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.identification.estimator import Problem, fit
from calibration.identification.model import REGISTRATION, Model
from calibration.identification.robust import RobustFit, robust_fit
from calibration.kinematics.joint_errors import JointErrors, none_yet, of_gears, of_sag

START_RAD = {"gear": 2e-5, "sag": 1e-4}
_NONE_RAD = 1e-9
_ROUNDS = 200
_SETTLED = 1e-3  # of the logarithm of a variance
_LEAST_NOISE = 1e-4  # times the assumed one
_GAIN = 1.0  # of twice the log-likelihood for each kind: one too many costs less than one missed


def with_joint_errors(
    problem: Problem, found: RobustFit, given: Mapping[str, float]
) -> tuple[Problem, RobustFit] | None:
    """``found`` solved again with errors of the joints beside the geometry; None where readings show none."""
    if not can_tell(problem, found.used, found.unknowns):
        return None
    components = _Components(problem, found, bool(given))
    best = components.solved(())
    for kinds in (("gear",), ("sag",), ("gear", "sag")):
        best = min(best, components.solved(kinds), key=lambda one: one.cost)
    if not best.sd:
        return None
    model = extended(problem.model, best.sd)
    wider = replace(problem, model=model)
    x = np.insert(found.fit.x, [len(problem.model.arm.names)] * (model.size - problem.model.size), 0.0)
    weight = found.used / (best.noise * found.noise.sigma(problem.range_m) ** 2)
    return wider, robust_fit(wider, given, fit(wider, x, weight))


def can_tell(problem: Problem, used: NDArray[np.bool_], unknowns: float) -> bool:
    """Whether there are readings enough: as many numbers left over as there are amplitudes."""
    amplitudes = len(errors_of(problem.model.without_errors(), START_RAD).amplitudes)
    return amplitudes > 0 and 3 * int(np.count_nonzero(used)) - unknowns >= amplitudes


def errors_of(model: Model, kinds: Iterable[str]) -> JointErrors:
    """The joint errors of these kinds that the model's arm may have; zero so far."""
    base = model.arm.base
    every = {
        "gear": lambda: of_gears(base.coupling, base.sliding),
        "sag": lambda: of_sag(base.coupling, base.alpha, base.sliding),
    }
    found = none_yet([], [], base.joints)
    for kind in kinds:
        found = every[kind]().beside(found)
    return found


def extended(model: Model, sd: Mapping[str, float]) -> Model:
    """``model`` with the amplitudes of joint errors after the arm's own parameters; ``sd`` (rad) by kind."""
    errors, own = errors_of(model, sd), len(model.arm.names)
    arm = model.arm.with_errors(errors)
    sizes = [next(sd[kind] for kind in sd if name.startswith(kind)) for name in errors.amplitudes]
    return replace(
        model,
        arm=arm,
        names=(*arm.names, *model.names[own:]),
        kinds=(*arm.kinds, *model.kinds[own:]),
        nominal=np.insert(model.nominal, [own] * len(sizes), 0.0),
        sd=np.insert(model.sd, [own] * len(sizes), sizes),
    )


@dataclass(frozen=True)
class _Sizes:
    """Standard deviations (rad) of the amplitudes by kind, the variance of the noise over the assumed one,
    and minus twice the restricted log-likelihood, with what each kind must gain."""

    sd: Mapping[str, float]
    noise: float
    cost: float


class _Components:
    """The linear problem of geometry, amplitudes and registration around ``found``."""

    def __init__(self, problem: Problem, found: RobustFit, noise_given: bool) -> None:
        model = extended(problem.model, START_RAD)
        self.rows = {
            kind: np.array([k for k, name in enumerate(model.names) if name.startswith(kind)], dtype=np.int64)
            for kind in START_RAD
        }
        added = np.sort(np.concatenate([*self.rows.values()]))
        start = np.insert(found.fit.x, [added[0]] * len(added), 0.0)
        _, J = model.linearised(start, problem.Q, problem.target)
        root = np.sqrt(found.used) / found.noise.sigma(problem.range_m)
        A, r = (J * root).reshape(len(J), -1), (found.fit.e * root).ravel()
        self.AA, self.Ar, self.squared = A @ A.T, A @ r, float(r @ r)
        self.precision = np.concatenate([model.sd**-2.0, np.zeros(REGISTRATION)])
        self.away = np.concatenate([model.nominal - start, np.zeros(REGISTRATION)])
        self.readings = 3 * int(np.count_nonzero(found.used))
        self.least_noise = 1.0 if noise_given else _LEAST_NOISE  # what was given may be too small

    def solved(self, kinds: tuple[str, ...]) -> _Sizes:
        """The sizes of ``kinds`` under which the readings are most likely; those of the others are zero."""
        sd = {kind: START_RAD[kind] if kind in kinds else _NONE_RAD for kind in self.rows}
        noise, cost = 1.0, np.inf
        for _ in range(_ROUNDS):
            precision = self.precision.copy()
            for kind, rows in self.rows.items():
                precision[rows] = sd[kind] ** -2.0
            H = self.AA / noise + np.diag(precision)
            scale = 1.0 / np.sqrt(np.diag(H))
            scaled = H * np.outer(scale, scale)
            C = np.linalg.inv(scaled) * np.outer(scale, scale)
            u = C @ (self.Ar / noise + precision * self.away)
            told = 1.0 - np.diag(C) * precision  # how much of each unknown the readings decide
            left = max(self.squared - 2.0 * float(u @ self.Ar) + float(u @ self.AA @ u), 0.0)
            moved = self.away - u
            priors = precision > 0.0
            cost = (
                self.readings * np.log(noise)
                + float(np.linalg.slogdet(scaled)[1] - 2.0 * np.sum(np.log(scale)))
                - float(np.sum(np.log(precision[priors])))
                + left / noise
                + float(np.sum(precision * moved**2))
            )
            before = np.array([noise, *(sd[kind] ** 2 for kind in kinds)])
            for kind in kinds:
                rows = self.rows[kind]
                decided = max(float(told[rows].sum()), 1e-9)
                sd[kind] = max(float(np.sqrt(u[rows] @ u[rows] / decided)), _NONE_RAD)
            noise = max(left / max(self.readings - float(told.sum()), 1.0), self.least_noise)
            after = np.array([noise, *(sd[kind] ** 2 for kind in kinds)])
            if np.max(np.abs(np.log(after / before))) < _SETTLED:
                break
        return _Sizes({kind: sd[kind] for kind in kinds}, noise, cost + _GAIN * len(kinds))
