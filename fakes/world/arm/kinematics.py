"""The twin's own arm kinematics: product of exponentials, from UR's published lengths.

``T_base_flange(q) = exp(S1 q1) ... exp(S6 q6) M`` with the screw axes ``S`` seen in the base while all
joints are at zero, and the flange's home pose ``M`` (Lynch and Park, Modern Robotics, chapter 4). The
solver that judges the twin composes link by link; the two meet only in a test.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.poses import Array

JOINTS = 6

# d1, a2, a3, d4, d5, d6 in metres, as Universal Robots publishes them.
_LENGTHS: dict[str, tuple[float, float, float, float, float, float]] = {
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur8long": (0.2186, -0.8989, -0.7149, 0.1824, 0.1361, 0.1434),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur15": (0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "ur18": (0.2186, -0.475, -0.3389, 0.1824, 0.1361, 0.1434),
    "ur20": (0.2363, -0.8620, -0.7287, 0.2010, 0.1593, 0.1543),
    "ur30": (0.2363, -0.6370, -0.5037, 0.2010, 0.1593, 0.1543),
}
_UNIT, _SIX = np.eye(4), np.eye(6)
_TWISTS = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)

MODELS = tuple(_LENGTHS)
CB3_MODELS = ("ur3", "ur5", "ur10")  # with controllers of version 3; all others have later ones


class UnreachableError(ValueError):
    """No joint angles near the given ones reach a pose."""


def _zeros() -> tuple[float, ...]:
    return (0.0,) * JOINTS


@dataclass(frozen=True)
class LinkDeltas:
    """Deviations of the links from the drawing, as UR's calibration reports them (rad and m, six each)."""

    delta_theta: tuple[float, ...] = field(default_factory=_zeros)
    delta_d: tuple[float, ...] = field(default_factory=_zeros)
    delta_a: tuple[float, ...] = field(default_factory=_zeros)
    delta_alpha: tuple[float, ...] = field(default_factory=_zeros)

    def __post_init__(self) -> None:
        for name, values in vars(self).items():
            if len(values) != JOINTS:
                raise ValueError(f"{name} needs {JOINTS} numbers, one per joint; got {len(values)}")

    def __add__(self, other: "LinkDeltas") -> "LinkDeltas":
        sums = (
            tuple(float(x + y) for x, y in zip(a, b, strict=True))
            for a, b in zip(vars(self).values(), vars(other).values(), strict=True)
        )
        return LinkDeltas(*sums)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Sequence[float]]) -> "LinkDeltas":
        """From ``{"delta_theta": [...], ...}``; keys that are missing are zero."""
        return cls(**{name: tuple(float(v) for v in row) for name, row in values.items()})


@dataclass(frozen=True)
class Chain:
    """A serial arm of revolute joints.

    ``screws`` is (6, 6), one row per joint: the axis' moment ``-w x p`` (m), then its direction ``w``,
    in the base with all joints at zero. ``M`` is the home pose ``T_base_flange(0)`` as a 4x4 matrix.
    """

    screws: Array
    M: Array
    _hats: Array = field(init=False, repr=False, compare=False)
    _squares: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        hats = np.zeros((len(self.screws), 4, 4))
        hats[:, :3, :3] = skew(self.screws[:, 3:])
        hats[:, :3, 3] = self.screws[:, :3]
        object.__setattr__(self, "_hats", hats)
        object.__setattr__(self, "_squares", hats @ hats)

    def matrix(self, q: ArrayLike) -> Array:
        """``T_base_flange`` as a 4x4 matrix for ``q`` (6,) rad, or (n, 4, 4) for (n, 6)."""
        e = self._exponentials(q)
        out: Array = e[..., 0, :, :]
        for i in range(1, JOINTS):
            out = out @ e[..., i, :, :]
        return out @ self.M

    def partial(self, q: ArrayLike) -> Array:
        """What the first 0, 1, ... 6 joints at ``q`` (6,) do to points that they carry: (7, 4, 4)."""
        e = self._exponentials(q)
        out = np.empty((JOINTS + 1, 4, 4))
        out[0] = np.eye(4)
        for i in range(JOINTS):
            np.matmul(out[i], e[i], out=out[i + 1])
        return out

    def forward(self, q: ArrayLike) -> RigidTransform:
        """``T_base_flange`` for ``q`` (6,) or (n, 6) rad."""
        return RigidTransform(self.matrix(q), normalize=False)

    def jacobian(self, q: ArrayLike, p_flange: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """Geometric Jacobian (6, 6) in the base: rows are velocity (m/s) of the point ``p_flange`` and
        angular velocity (rad/s) per joint speed."""
        return self.pose_and_jacobian(q, p_flange)[1]

    def pose_and_jacobian(self, q: ArrayLike, p_flange: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Array, Array]:
        """:meth:`matrix` and :meth:`jacobian` at ``q`` (6,), which share most of their work."""
        carried = self.partial(q)
        flange: Array = carried[-1] @ self.M
        return flange, self._jacobian(carried, flange, p_flange)

    def _jacobian(self, carried: Array, flange: Array, p_flange: ArrayLike) -> Array:
        R, p = carried[:-1, :3, :3], carried[:-1, :3, 3]
        point = flange[:3, :3] @ np.asarray(p_flange, dtype=float) + flange[:3, 3]
        turned = R[:, None] @ self.screws.reshape(JOINTS, 2, 3, 1)
        moments, axes = turned[:, 0, :, 0].T, turned[:, 1, :, 0].T
        return np.concatenate([moments + _cross(axes, (point - p).T), axes])

    def levers(self) -> Array:
        """Upper bounds (6,) of each joint axis' distance from the flange, m, whatever the joints' angles.

        A chain of points, each on its axis and near the one after it: whatever turns, the distance of two
        neighbours stays.
        """
        out = np.empty(JOINTS)
        point, far = self.M[:3, 3], 0.0
        for i in reversed(range(JOINTS)):
            moment, w = self.screws[i, :3], self.screws[i, 3:]
            on_axis = np.cross(w, moment)
            nearest = on_axis + w * (w @ (point - on_axis))
            far += float(np.linalg.norm(point - nearest))
            out[i], point = far, nearest
        return out

    def inverse(self, T_base_flange: RigidTransform, q_near: ArrayLike, tolerance: float = 1e-10) -> Array:
        """Joint angles (6,) rad that reach the pose, found from ``q_near`` by damped Newton steps.

        Stays on the branch of ``q_near``. The damping follows Levenberg and Marquardt, so a start near a
        singularity slows down instead of leaping. Raises :class:`UnreachableError`.
        """
        return self.joints_at(T_base_flange.as_matrix(), q_near, tolerance)

    def joints_at(self, goal: Array, q_near: ArrayLike, tolerance: float = 1e-10) -> Array:
        """The same for a pose given as a 4x4 matrix."""
        q = np.array(q_near, dtype=float)
        carried = self.partial(q)
        reached = carried[-1] @ self.M
        gap = _gap(goal, reached)
        damping = 1e-6
        for _ in range(100):
            if max(map(abs, gap.tolist())) < tolerance:
                return q
            J = self._jacobian(carried, reached, (0.0, 0.0, 0.0))
            step = J.T @ np.linalg.solve(J @ J.T + damping * _SIX, gap)
            step *= min(1.0, 0.5 / max(*map(abs, step.tolist()), 1e-12))
            candidate = q + step
            new_carried = self.partial(candidate)
            new_reached = new_carried[-1] @ self.M
            new_gap = _gap(goal, new_reached)
            if new_gap @ new_gap < gap @ gap:
                q, gap, damping = candidate, new_gap, max(damping / 10.0, 1e-14)
                carried, reached = new_carried, new_reached
            else:
                damping *= 10.0
                if damping > 1e3:
                    break
        raise UnreachableError(
            f"no joints near the start reach the pose: {np.linalg.norm(gap[:3]) * 1e3:.3f} mm and "
            f"{np.linalg.norm(gap[3:]):.2e} rad are left"
        )

    def _exponentials(self, q: ArrayLike) -> Array:
        """exp of each screw, (..., 6, 4, 4). For axes without pitch hat^3 = -hat closes the series."""
        angles = np.asarray(q, dtype=float)[..., None, None]
        out: Array = _UNIT + np.sin(angles) * self._hats + (1.0 - np.cos(angles)) * self._squares
        return out


def skew(v: Array) -> Array:
    """Cross product matrices (..., 3, 3) of ``v`` (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def displacement(xi: Array) -> Array:
    """SE(3) exponential (4, 4) of ``xi`` (6,) = (translation part, rotation part), m and rad."""
    angle = math.hypot(*xi[3:].tolist())
    if angle == 0.0:
        shift = np.eye(4)
        shift[:3, 3] = xi[:3]
        return shift
    hat = skew(xi[3:])
    square = hat @ hat
    half = 0.5 * angle
    b = 0.5 * (math.sin(half) / half) ** 2
    # Its difference of near equals is lost below a hundredth, where two terms of its series are exact.
    c = (angle - math.sin(angle)) / angle**3 if angle > 0.01 else (1.0 - angle**2 / 20.0) / 6.0
    a = 1.0 - c * angle**2
    out = np.eye(4)
    out[:3, :3] += a * hat + b * square
    out[:3, 3] = xi[:3] + b * (hat @ xi[:3]) + c * (square @ xi[:3])
    return out


def dh_parameters(model: str, deltas: LinkDeltas | None = None) -> tuple[Array, Array, Array, Array]:
    """Denavit-Hartenberg ``theta, d, a, alpha`` (6,), rad and m: the drawing of ``model`` plus ``deltas``."""
    if model not in _LENGTHS:
        raise ValueError(f"unknown arm model {model!r}; known are {', '.join(MODELS)}")
    d1, a2, a3, d4, d5, d6 = _LENGTHS[model]
    deltas = deltas or LinkDeltas()
    d: Array = np.array([d1, 0.0, 0.0, d4, d5, d6]) + deltas.delta_d
    a: Array = np.array([0.0, a2, a3, 0.0, 0.0, 0.0]) + deltas.delta_a
    alpha: Array = np.array(_TWISTS) + deltas.delta_alpha
    return np.array(deltas.delta_theta), d, a, alpha


def chain(model: str, deltas: LinkDeltas | None = None) -> Chain:
    """The arm ``model`` ("ur10e", ...) with its links off the drawing by ``deltas``.

    The deltas are folded into where the axes lie at zero; joint angles keep their meaning.
    """
    return chain_of(*dh_parameters(model, deltas))


def chain_of(theta: Array, d: Array, a: Array, alpha: Array) -> Chain:
    """The arm with these Denavit-Hartenberg parameters, (6,) each, rad and m."""
    frames = _matrices_at_zero(theta, d, a, alpha)
    axes, points = frames[:-1, :3, 2], frames[:-1, :3, 3]
    return Chain(np.concatenate([np.cross(points, axes), axes], axis=1), frames[-1])


def frames_at_zero(theta: Array, d: Array, a: Array, alpha: Array) -> list[RigidTransform]:
    """The base and the frame after every joint with all joints at zero."""
    return [RigidTransform(frame) for frame in _matrices_at_zero(theta, d, a, alpha)]


def _matrices_at_zero(theta: Array, d: Array, a: Array, alpha: Array) -> Array:
    """(7, 4, 4) the matrices of :func:`frames_at_zero`."""
    frames = np.tile(np.eye(4), (JOINTS + 1, 1, 1))
    for i in range(JOINTS):
        c, s, ca, sa = math.cos(theta[i]), math.sin(theta[i]), math.cos(alpha[i]), math.sin(alpha[i])
        link = [[c, -s * ca, s * sa, a[i] * c], [s, c * ca, -c * sa, a[i] * s], [0.0, sa, ca, d[i]]]
        frames[i + 1, :3] = frames[i, :3] @ np.array([*link, [0.0, 0.0, 0.0, 1.0]])
    return frames


def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _gap(goal: Array, reached: Array) -> Array:
    """Position difference (m) and rotation vector (rad) from ``reached`` to ``goal``, in the base."""
    out = np.empty(6)
    out[:3] = goal[:3, 3] - reached[:3, 3]
    out[3:] = rotation_vector(goal[:3, :3] @ reached[:3, :3].T)
    return out


def rotation_vector(R: Array) -> Array:
    """Of a rotation matrix (3, 3), rad."""
    return np.array(rotation_vector_of(R.tolist()))


def rotation_vector_of(rows: list[list[float]]) -> list[float]:
    """Of a rotation matrix's rows, rad, by its quaternion (Shepperd 1978): exact at half turns too, and much
    faster than a general library where every control cycle asks."""
    a, b, c = rows[0][0], rows[1][1], rows[2][2]
    trace = a + b + c
    i = 0 if a >= b and a >= c else 1 if b >= c else 2
    if trace > rows[i][i]:
        w = 1.0 + trace
        v = [rows[2][1] - rows[1][2], rows[0][2] - rows[2][0], rows[1][0] - rows[0][1]]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        w = rows[k][j] - rows[j][k]
        v = [0.0, 0.0, 0.0]
        v[i] = 1.0 + rows[i][i] - rows[j][j] - rows[k][k]
        v[j], v[k] = rows[i][j] + rows[j][i], rows[i][k] + rows[k][i]
    size = math.hypot(*v)
    if w < 0.0:  # the same turn, the short way
        w, v = -w, [-x for x in v]
    scale = 2.0 * math.atan2(size, w) / size if size > 1e-12 * w else 2.0 / w
    return [scale * x for x in v]
