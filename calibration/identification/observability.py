"""What the readings determine: the rank, the combinations that stay open, in words, and what is refused.

Some parameters of an arm cannot be told apart by any readings: two links whose lengths only add up, or the
arm's first turn and the tracker's own. Others are open because these poses do not move what would show them.
The first are named; the second are a fault of the poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identification.estimator import Problem, normal_matrix
from calibration.identification.model import REGISTRATION, Model
from calibration.refusal import Refusal
from cell.poses import Array

_NULL = 1e-10  # of the largest eigenvalue, columns of equal size; real directions are above 1e-6
_CLEAR = 1e-6  # of the largest eigenvalue at poses everywhere: what good poses show beyond doubt
_SMALL = 0.03  # of the largest entry of a combination: not worth a word
# Of a parameter in all open directions together: which basis of them an eigenvalue solver finds is its own.
_TAKES_PART = 0.01
_STILL = 0.01  # rad or m that a joint must move
_SAME = 1e-3  # rad or m; closer joint vectors are one pose
_RANDOM_POSES = 80
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Observability:
    """``rank`` of the parameters with the registration free, and ``rank_alone`` with it known;
    ``rank_possible`` is what poses all over the joints' ranges would reach with the registration free.

    ``unidentifiable`` says each open combination in words; ``open`` (p,) tells which parameters take part.
    ``lacking`` are directions that other poses would show, in words; ``condition`` is the ratio of the
    largest and the smallest singular value that is not zero (columns of equal size).
    """

    rank: int
    rank_alone: int
    rank_possible: int
    unidentifiable: tuple[str, ...]
    open: np.ndarray
    lacking: tuple[str, ...]
    condition: float

    @property
    def unknowns(self) -> int:
        """Numbers that good poses determine, registration included."""
        return self.rank_possible + REGISTRATION


def observe(problem: Problem, J: Array, weight: Array, x: Array) -> Observability:
    """Rank and open combinations of the readings with derivatives ``J`` (p + 6, 3, n)."""
    model, p = problem.model, problem.model.size
    H = normal_matrix(J, weight)
    whole, alone = _null(H), _null(H[:p, :p])
    general = _null(_anywhere(problem, x), _CLEAR)
    lacking: tuple[str, ...] = ()
    if whole.count > general.count:
        lacking = tuple(_lacking(problem, whole.vectors, general.vectors))
    return Observability(
        rank=p - whole.count,
        rank_alone=p - alone.count,
        rank_possible=p - general.count,
        unidentifiable=(*_combinations(model, alone.vectors), *_with_tracker(model, whole, alone)),
        open=np.linalg.norm((whole.vectors / whole.scale[:, None])[:p], axis=1) > _TAKES_PART,
        lacking=lacking,
        condition=whole.condition,
    )


def refuse(problem: Problem, found: Observability, has_prior: bool, copies: int = 0) -> Refusal | None:
    """Why these poses cannot determine the arm, or None. A prior of the robot's own may fill in.

    ``copies`` are samples that were left out because they repeat others to the last digit.
    """
    n, unknowns = _distinct(problem), found.unknowns
    if has_prior and 3 * n >= REGISTRATION + 3:
        return None
    if n < problem.n + copies and 3 * n < unknowns + 3:
        return Refusal(
            "poses-not-distinct",
            f"only {n} of {problem.n + copies} samples have joints of their own; {_needed(unknowns)}",
        )
    if 3 * n < unknowns + 3:
        return Refusal("too-few-poses", f"{n} samples give {3 * n} numbers; {_needed(unknowns)}")
    still = still_joints(problem)
    if still:
        names = " and ".join(f"joint {j + 1}" for j in still)
        return Refusal(
            "joint-still",
            f"{names} does not move in the samples, so {'; '.join(found.lacking) or 'its link'} cannot be "
            "determined; add poses that move it, or give the robot a prior",
        )
    if found.lacking:
        return Refusal(
            "unobservable",
            f"these poses do not tell {'; '.join(found.lacking)}; add poses that move every joint "
            "independently of the others, or give the robot a prior",
        )
    return None


def still_joints(problem: Problem) -> list[int]:
    """Joints that hardly move, judged at the links that they drive."""
    gear = np.max(np.abs(problem.model.arm.base.coupling), axis=0)
    moved = np.ptp(problem.Q, axis=0) * np.maximum(gear, 1e-12)
    return [int(j) for j in np.flatnonzero(moved < _STILL)]


@dataclass(frozen=True, eq=False)
class _Null:
    vectors: Array  # (k, count), in metres, radians and ratios, orthonormal where columns have equal size
    scale: Array
    count: int
    condition: float


def _null(H: Array, limit: float = _NULL) -> _Null:
    D = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    D[np.diag(H) <= 0.0] = 1.0
    values, vectors = np.linalg.eigh(H * np.outer(D, D))
    count = int(np.sum(values < limit * values[-1]))
    condition = float(np.sqrt(values[-1] / values[count])) if count < len(values) else np.inf
    return _Null(D[:, None] * vectors[:, :count], D, count, condition)


def _anywhere(problem: Problem, x: Array) -> Array:
    """The normal matrix of poses all over the joints' ranges, with the same targets."""
    rng = np.random.default_rng(0)
    chain = problem.model.arm.base
    gear = np.max(np.abs(chain.coupling), axis=0)
    reach = np.pi / np.maximum(gear, 1e-9)
    # sliding joints have no natural range: take that of the samples, at least half a metre
    drives = np.abs(chain.coupling).argmax(axis=0)
    middle, span = problem.Q.mean(axis=0), np.maximum(np.ptp(problem.Q, axis=0), 0.5)
    slides = chain.sliding[drives]
    low = np.where(slides, middle - span / 2, -reach)
    high = np.where(slides, middle + span / 2, reach)
    present = np.unique(problem.target)
    Q = rng.uniform(low, high, (_RANDOM_POSES, problem.model.arm.joints))
    _, J = problem.model.linearised(x, Q, present[np.arange(len(Q)) % len(present)])
    return normal_matrix(J, np.ones(len(Q)))


def _needed(unknowns: int) -> str:
    return f"{unknowns} unknowns (registration of the tracker included) need at least {(unknowns + 5) // 3}"


def pose_numbers(problem: Problem) -> NDArray[np.int64]:
    """(n,): readings at the same joints have the same number, counted in the order of their first ones."""
    _, first, same = np.unique(_cells(problem), axis=0, return_index=True, return_inverse=True)
    order = np.empty(len(first), dtype=np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    return order[same.ravel()]


def _cells(problem: Problem) -> Array:
    gear = np.max(np.abs(problem.model.arm.base.coupling), axis=0)
    return np.asarray(np.round(problem.Q * np.maximum(gear, 1e-12) / _SAME))


def _distinct(problem: Problem) -> int:
    return len(np.unique(np.column_stack([_cells(problem), problem.target]), axis=0))


def _reduced(Z: Array, order: Sequence[int]) -> tuple[Array, list[int]]:
    """Rows that span the columns of ``Z`` (k, c), each with a pivot that no other row has, and the pivots.

    Pivots are taken in the given order where the entry is large enough.
    """
    rows = Z.T.copy()
    rows /= np.maximum(np.max(np.abs(rows), axis=1, keepdims=True), 1e-300)
    pivots: list[int] = []
    for column in order:
        k = len(pivots)
        if k == len(rows):
            break
        best = k + int(np.argmax(np.abs(rows[k:, column])))
        if abs(rows[best, column]) < _SMALL:
            continue
        rows[[k, best]] = rows[[best, k]]
        rows[k] /= rows[k, column]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, column] * rows[k]
        rest = rows[k + 1 :]
        rest /= np.maximum(np.max(np.abs(rest), axis=1, keepdims=True), 1e-300)
        pivots.append(int(column))
    return rows[: len(pivots)], pivots


def _pivot_order(model: Model) -> list[int]:
    """Angles before lengths, far links before near ones, places of targets last: short combinations."""
    own = len(model.arm.names)
    angles = [k for k in range(own) if model.kinds[k] != "length"]
    lengths = [k for k in range(own) if model.kinds[k] == "length"]
    far = sorted(angles, key=lambda k: -_link(model, k)) + sorted(lengths, key=lambda k: -_link(model, k))
    return far + list(range(own, model.size))


def _link(model: Model, k: int) -> int:
    digits = "".join(c if c.isdigit() else " " for c in model.names[k]).split()
    return int(digits[0]) if digits and k < len(model.arm.names) else 99


def _combinations(model: Model, Z: Array) -> list[str]:
    """Sums of which only the total shows, then the rest."""
    sums: dict[int, list[tuple[int, int]]] = {}
    out = []
    for row, pivot in zip(*_reduced(Z, _pivot_order(model)), strict=True):
        rest = np.abs(row)
        rest[pivot] = 0.0
        others = [int(k) for k in np.flatnonzero(rest > max(_SMALL * float(rest.max()), 1e-9))]
        alike = len(others) == 1 and model.kinds[others[0]] == model.kinds[pivot]
        if alike and abs(abs(row[others[0]]) - 1.0) < 1e-3:
            sums.setdefault(others[0], [(others[0], 1)]).append((pivot, -1 if row[others[0]] > 0.0 else 1))
        else:
            out.append(_combination(model, row, pivot, others))
    return [_sum(model, sorted(terms)) for terms in sums.values()] + out


def _sum(model: Model, terms: list[tuple[int, int]]) -> str:
    """``terms``: parameters and the signs with which they add up."""
    names = [model.names[k] for k, _ in terms]
    signs = ["+" if sign == terms[0][1] else "-" for _, sign in terms]
    total = names[0] + "".join(f" {s} {n}" for s, n in zip(signs[1:], names[1:], strict=True))
    return f"{' = '.join(names)}: only {total} is determined"


def _combination(model: Model, row: Array, pivot: int, others: Sequence[int]) -> str:
    name = model.names[pivot]
    if not others:
        return f"{name}: no reading depends on it"
    listed = _and([model.names[k] for k in others])
    like = _and([f"{model.names[k]} {row[k]:+.3f} {_unit(model, k)}" for k in others])
    return f"{name} with {listed}: {name} +1 {_unit(model, pivot)} together with {like} moves nothing"


def _unit(model: Model, k: int) -> str:
    return {"length": "mm", "angle": "mrad", "ratio": "per mille"}[model.kinds[k]]


def _with_tracker(model: Model, whole: _Null, alone: _Null) -> list[str]:
    """What the registration takes up, beyond what the arm leaves open by itself."""
    p = model.size
    padded = np.vstack([alone.vectors, np.zeros((REGISTRATION, alone.count))])
    far = sorted(range(p), key=lambda k: -_link(model, k))
    rows, pivots = _reduced(padded, far)
    Z = whole.vectors.copy()
    for row, pivot in zip(rows, pivots, strict=True):
        Z -= np.outer(row, Z[pivot])
    norm = np.max(np.abs(Z), axis=0)
    U, S, _ = np.linalg.svd(Z / np.maximum(norm, 1e-300), full_matrices=False)
    Z = U[:, : whole.count - alone.count] if len(S) else Z
    out = []
    near = [k for k in sorted(range(p), key=lambda k: _link(model, k)) if k not in pivots]
    for row, pivot in zip(*_reduced(Z, near), strict=True):
        size = np.max(np.abs(row))
        others = [model.names[k] for k in np.flatnonzero(np.abs(row[:p]) > _SMALL * size) if k != pivot]
        tracker = row[p:] / max(np.max(np.abs(row[p:])), 1e-300)
        moves = [
            f"{'turn about' if k < 3 else 'shift along'} base {_AXES[k % 3]}"
            for k in np.flatnonzero(np.abs(tracker) > 0.1)
        ]
        name = model.names[pivot]
        with_ = f" with {_and(others)}" if others else ""
        out.append(f"{name}{with_}: looks like the tracker's registration ({_and(moves)})")
    return out


def _lacking(problem: Problem, Z: Array, general: Array) -> list[str]:
    """Open combinations of these poses that other poses would determine."""
    model = problem.model
    size = np.max(np.abs(Z), axis=1, keepdims=True) + 1e-12
    basis, _ = np.linalg.qr(general / size) if general.shape[1] else (np.zeros((len(Z), 0)), None)
    rest = Z / size - basis @ (basis.T @ (Z / size))
    U, _, _ = np.linalg.svd(rest, full_matrices=False)
    count = Z.shape[1] - general.shape[1]
    rows, pivots = _reduced(U[:, :count] * size, _pivot_order(model))
    out = []
    for row, pivot in zip(rows, pivots, strict=True):
        others = [
            model.names[int(k)]
            for k in np.flatnonzero(np.abs(row[: model.size]) > 0.2 * np.max(np.abs(row[: model.size])))
            if k != pivot
        ]
        out.append(f"{model.names[pivot]} from {_and(others)}" if others else model.names[pivot])
    return out


def _and(words: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]])) if words else ""
