"""Which poses to measure: those after which the arm's predictions elsewhere are best.

The criterion is the mean variance of predictions at validation poses (I-optimality, Box and Draper 1959).
Poses are taken one by one where they lower it most, then exchanged (Fedorov 1972; Mitchell 1974), at last for
poses close by that were not among the candidates: the best ones lie at the edge of what is possible.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identification.model import REGISTRATION, Model, Targets
from cell.poses import Array

_REGISTRATION_SD = 1.0  # rad and m: nothing is known of the tracker's place
_PASSES = 3
_SWEEPS = 5
_NEARBY = 20  # per pose and sweep
_FIRST_STEP, _SHRINK = 0.5, 0.7  # rad at the links, or m
_DRAWS = 40

Rows = Sequence[int] | NDArray[np.int64]
Promise = Callable[[Array, Targets], Array]

RULE_POSES = 50
RULE_ANGLE = np.radians(15.0)


@dataclass(frozen=True, eq=False)
class Design:
    """Candidates (c) for a plan: derivatives ``J`` (c, 3, k) and what is aimed at.

    ``variance`` (c,) of a reading along one axis, m^2; ``before`` (k, k) the information there is anyway:
    the prior's, and that of readings already made; ``aim`` (k, k) the mean over validation poses of J^T J.
    """

    J: Array
    variance: Array
    before: Array
    aim: Array

    def predicted_rms(self, rows: Rows) -> float:
        """Root mean square 3D error (m) of predictions at the validation poses, from candidates ``rows``."""
        return float(np.sqrt(np.sum(_covariance(self.information(rows)) * self.aim)))

    def information(self, rows: Rows) -> Array:
        """(k, k): what is known after candidates ``rows``."""
        J = self.J[list(rows)]
        out: Array = self.before + np.einsum("nak,nal,n->kl", J, J, 1.0 / self.variance[list(rows)])
        return out


def make_design(
    model: Model,
    x: Array,
    Q: Array,
    target: Targets,
    sigma: Array,
    validation: Array,
    *,
    measured: tuple[Array, Targets, Array] | None = None,
) -> Design:
    """A design for an arm ``x`` (p,), nominal before anything is known.

    ``Q`` (c, j) are candidates that can be reached and seen, ``target`` (c,) their reflectors and ``sigma``
    (c,) m what the tracker promises there; ``validation`` (v, j) joints where predictions shall be good (the
    first target is taken). ``measured`` are joints, targets and sigmas of readings already made.
    """
    sd = np.concatenate([model.sd, np.full(REGISTRATION, _REGISTRATION_SD)])
    before = np.diag(sd**-2.0)
    if measured is not None:
        _, J = model.linearised(x, measured[0], measured[1])
        rows = (J / measured[2]).reshape(len(J), -1)
        before = before + rows @ rows.T
    _, Jv = model.linearised(x, validation, np.zeros(len(validation), dtype=np.int64))
    flat = Jv.reshape(len(Jv), -1)
    _, J = model.linearised(x, Q, target)
    return Design(
        J=np.ascontiguousarray(J.transpose(2, 1, 0)),
        variance=np.asarray(sigma, dtype=float) ** 2,
        before=before,
        aim=flat @ flat.T / len(validation),
    )


def choose(design: Design, count: int) -> NDArray[np.int64]:
    """``count`` candidates, in the order in which they were taken; each at most once."""
    chosen: list[int] = []
    free = np.ones(len(design.J), dtype=bool)
    information = design.before.copy()
    for _ in range(min(count, len(design.J))):
        row = _best(design, information, free)
        information += _own(design, row)
        free[row] = False
        chosen.append(row)
    for _ in range(_PASSES):
        if not _exchange(design, chosen, free, information):
            break
    return np.array(chosen, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Plan:
    """Joints ``q`` (n, j) to measure at with reflectors ``target`` (n,), the predicted error (m, RMS at the
    validation poses) after them, and that after as many candidates taken at random (RMS of many draws)."""

    q: Array
    target: Targets
    predicted_rms: float
    random_rms: float


def choose_poses(
    model: Model,
    x: Array,
    candidates: Array,
    target: Targets,
    promise: Promise,
    validation: Array,
    count: int,
    *,
    measured: tuple[Array, Targets, Array] | None = None,
) -> Plan:
    """``count`` poses out of ``candidates`` (c, j) and their neighbourhood.

    ``promise(Q, target)`` (n, j), (n,) -> (n,) is what the tracker promises there (standard deviation along
    one axis, m), NaN where the arm may not go or the reflector is not seen. Raises ``ValueError`` when fewer
    than ``count`` candidates are possible. The same input gives the same plan.
    """
    rng = np.random.default_rng(0)
    sigma = promise(candidates, target)
    possible = np.isfinite(sigma)
    Q, target, sigma = candidates[possible], target[possible], sigma[possible]
    if len(Q) < count:
        raise ValueError(
            f"only {len(Q)} of {len(candidates)} candidate poses are possible; {count} are wanted"
        )
    design = make_design(model, x, Q, target, sigma, validation, measured=measured)
    draws = [design.predicted_rms(rng.permutation(len(Q))[:count]) for _ in range(_DRAWS)]
    rows = choose(design, count)
    q, own, s = Q[rows], target[rows], sigma[rows]
    gear = np.maximum(np.max(np.abs(model.arm.base.coupling), axis=0), 1e-12)
    for sweep in range(_SWEEPS):
        step = _FIRST_STEP * _SHRINK**sweep / gear
        near = (q[:, None] + rng.normal(size=(len(q), _NEARBY, q.shape[1])) * step).reshape(-1, q.shape[1])
        around = np.repeat(own, _NEARBY)
        sigma = promise(near, around)
        possible = np.isfinite(sigma)
        q, own, s = (
            np.concatenate([q, near[possible]]),
            np.concatenate([own, around[possible]]),
            np.concatenate([s, sigma[possible]]),
        )
        design = make_design(model, x, q, own, s, validation, measured=measured)
        chosen, free = list(range(count)), np.ones(len(q), dtype=bool)
        free[:count] = False
        _exchange(design, chosen, free, design.information(chosen))
        q, own, s = q[chosen], own[chosen], s[chosen]
    final = make_design(model, x, q, own, s, validation, measured=measured)
    return Plan(q, own, final.predicted_rms(range(count)), float(np.sqrt(np.mean(np.square(draws)))))


def _exchange(design: Design, chosen: list[int], free: NDArray[np.bool_], information: Array) -> bool:
    """One pass: every chosen candidate gives way if another serves better without it."""
    changed = False
    for k, row in enumerate(chosen):
        information -= _own(design, row)
        free[row] = True
        better = _best(design, information, free)
        free[better] = False
        information += _own(design, better)
        changed |= better != row
        chosen[k] = better
    return changed


def _best(design: Design, information: Array, free: NDArray[np.bool_]) -> int:
    """The free candidate that lowers the criterion most: tr((s^2 + J C J^T)^-1 J C M C J^T)."""
    C = _covariance(information)
    rows = np.flatnonzero(free)
    J = design.J[rows]
    JC = J @ C
    S = JC @ J.swapaxes(1, 2) + design.variance[rows, None, None] * np.eye(3)
    K = JC @ design.aim @ JC.swapaxes(1, 2)
    gain = np.trace(np.linalg.solve(S, K), axis1=1, axis2=2)
    return int(rows[int(np.argmax(gain))])


def _own(design: Design, row: int) -> Array:
    J = design.J[row]
    own: Array = J.T @ J / design.variance[row]
    return own


def _covariance(information: Array) -> Array:
    D = 1.0 / np.sqrt(np.diag(information))
    C: Array = np.linalg.inv(information * np.outer(D, D)) * np.outer(D, D)
    return C


@dataclass(frozen=True)
class SourceRule:
    """The rule of thumb: at least 50 poses, and every joint more than 15 degrees apart from one to the next.

    ``smallest_rad`` is the smallest such step, ``short_steps`` how many poses follow with a shorter one.
    """

    poses: int
    short_steps: int
    smallest_rad: float

    @property
    def kept(self) -> bool:
        return self.poses >= RULE_POSES and self.short_steps == 0


def source_rule(Q: Array) -> SourceRule:
    """Check joints ``Q`` (n, j), rad at the links, against the rule of thumb."""
    if len(Q) < 2:
        return SourceRule(len(Q), 0, float("inf"))
    steps = np.min(np.abs(np.diff(Q, axis=0)), axis=1)
    return SourceRule(len(Q), int(np.sum(steps <= RULE_ANGLE)), float(steps.min()))
