"""Errors of gears and sag as unknowns, as large as the readings say that they are.

This is a set-up of the adjustment: the arm's numbers and the places of the reflectors with their priors, the
kinds of errors as blocks whose prior's scale the readings tell together with the size of the noise, and the
tracker's place without a prior. A kind is in the solution where the evidence says so.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.components import Components, estimated, evidence
from calibration.adjustment.equations import Observations, Prior
from calibration.identification.estimator import Problem, fit
from calibration.identification.model import REGISTRATION, Model
from calibration.identification.robust import RobustFit, robust_fit
from calibration.kinematics.joint_errors import JointErrors, none_yet, of_gears, of_sag
from cell.poses import Array

_READING = "reading"  # the noise, over the assumed one
_LEAST_NOISE = 1e-2  # times the assumed one
_GAIN = 1.0  # of twice the log-evidence for each kind: one too many costs less than one missed


def with_joint_errors(
    problem: Problem, found: RobustFit, given: Mapping[str, float]
) -> tuple[Problem, RobustFit] | None:
    """``found`` solved again with errors of the joints beside the geometry; None where readings show none."""
    if not can_tell(problem, found.used, found.unknowns):
        return None
    adjustment = _Adjustment(problem, found)
    least = 1.0 if given else _LEAST_NOISE  # what was given may be too small
    most, best = -np.inf, Components({}, {}, frozenset())
    for kinds in ((), ("gear",), ("sag",), ("gear", "sag")):
        gain, components = adjustment.solved(kinds, least)
        if gain > most:
            most, best = gain, components
    if not best.scale:
        return None
    expected = problem.model.error_sd
    wider, x = _widened(problem, found, {kind: s * expected[kind] for kind, s in best.scale.items()})
    weight = found.used / (best.sigma[_READING] * found.noise.sigma(problem.range_m)) ** 2
    return wider, robust_fit(wider, given, fit(wider, x, weight))


def _widened(problem: Problem, found: RobustFit, sd: Mapping[str, float]) -> tuple[Problem, Array]:
    """The problem with the kinds in ``sd`` (rad) as unknowns, and ``found`` for it."""
    model = extended(problem.model, sd)
    x = np.insert(found.fit.x, [len(problem.model.arm.names)] * (model.size - problem.model.size), 0.0)
    return replace(problem, model=model), x


def can_tell(problem: Problem, used: NDArray[np.bool_], unknowns: float) -> bool:
    """Whether there are readings enough: as many numbers left over as there are amplitudes."""
    model = problem.model
    amplitudes = len(errors_of(model.without_errors(), model.error_sd).amplitudes)
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


class _Adjustment:
    """Geometry, amplitudes and the tracker's place, linear around ``found``."""

    def __init__(self, problem: Problem, found: RobustFit) -> None:
        wider, x = _widened(problem, found, problem.model.error_sd)
        model = wider.model
        _, J = model.linearised(x, problem.Q, problem.target)
        root = 1.0 / found.noise.sigma(problem.range_m)
        A, off = (
            (J * root)[:, :, found.used].reshape(len(J), -1),
            -(found.fit.e * root)[:, found.used].ravel(),
        )
        self.sums = Observations.of_sums(A, off)
        place = np.zeros(REGISTRATION)
        self.at, self.mean = np.append(x, place), np.append(model.nominal, place)
        self.sd = np.append(model.sd, place + np.inf)
        geometric = np.append(model.geometric, place == 0.0)
        self.common = np.flatnonzero(geometric)
        self.rows = {
            kind: np.array(
                [k for k, name in enumerate(model.names) if name.startswith(kind) and not geometric[k]],
                dtype=np.int64,
            )
            for kind in model.error_sd
        }

    def solved(self, kinds: tuple[str, ...], least: float) -> tuple[float, Components]:
        """The scales of ``kinds`` and the noise that the readings tell, and twice their log-evidence less
        what each kind must gain; the errors of other kinds are zero."""
        blocks, rows = dict[str, slice](), self.common
        for kind in kinds:
            blocks[kind] = slice(len(rows), len(rows) + len(self.rows[kind]))
            rows = np.concatenate([rows, self.rows[kind]])
        obs = self.sums.of_unknowns(rows)
        prior = Prior(self.mean[rows], self.sd[rows], blocks)
        start = Components(
            {_READING: 1.0},
            dict.fromkeys(kinds, 1.0),
            frozenset([_READING, *kinds]),
            least={_READING: least},
            of_sums=_READING,
        )
        components = estimated(obs, prior, self.at[rows], start)
        return 2.0 * evidence(obs, prior, self.at[rows], components) - _GAIN * len(kinds), components
