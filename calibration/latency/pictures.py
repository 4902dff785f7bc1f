"""The delay of a camera's stamps, from pictures of a target while the arm moves to and fro.

A picture that is stamped ``tau`` late shows the target where it was ``tau`` before. What else is unknown is
found with it: where the target is seen from the place at which the way is referred to, the camera's pose
about what is known of it, and by how much the arm lags behind its joints' sensors whatever its speed
(``hysteresis``: play changes its side with the direction). To and fro parts the delay from the places, two
speeds part it from the hysteresis. Each point of a rolling shutter is seen at the time of its own row.

With the flange at ``B`` and at ``B0`` at the reference, the target is at ``X^-1 D X M`` in the camera, with
``D = B^-1 B0`` and ``X = T_flange_camera`` for a camera on the flange, ``D = B B0^-1`` and
``X = T_base_camera`` for a fixed one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.pnp import solve_pnp
from calibration.hand_eye.problem import Setup
from calibration.hand_eye.views import CornerSet
from calibration.latency.delay import Delay, DelayUndetermined, leave_out
from cell.devices import Intrinsics
from cell.poses import Array

FEWEST_LOOKS, FEWEST_PAIRS, FEWEST_POINTS = 12, 4, 4
ONE_SPEED = 1.2  # ratio of speeds below which delay and hysteresis cannot be told apart
_CAMERA_M, _CAMERA_RAD = 0.02, 0.05  # standard deviations of what is known of the camera's pose
_STEPS, _SETTLED_S, _STEP = 12, 1e-7, 1e-6
_BETWEEN_S = 2e-3  # before and after a picture's middle row: what its target moves in that time
_MARGIN_S = 0.02
_MOVES, _EVEN = 0.3, 0.9  # of a way's speed, and of the faster of what comes before and after
_OUTLIER = 5.0  # times the median RMS of a look
_TAU, _HYSTERESIS = 12, 13


@dataclass(frozen=True, eq=False)
class Way:
    """One way of the arm, out (``direction`` 1) or back (-1), of the ``pair`` (out and back) of this number.

    ``t`` (n,) s are the arm's stamps and ``T`` (n, 4, 4) its flange in the base; ``speed`` m/s.
    """

    pair: int
    direction: int
    speed: float
    t: Array
    T: Array


@dataclass(frozen=True, eq=False)
class Look:
    """One picture on the way of this number: ``points`` (m, 3) of the target at ``corners`` (m, 2) px.

    ``t`` is the camera's stamp of the first row, s.
    """

    way: int
    t: float
    row_time_s: float
    points: Array
    corners: Array


def solve_pictures(
    setup: Setup, camera: Intrinsics, X: Array, ways: Sequence[Way], looks: Sequence[Look]
) -> Delay:
    """``X`` (4, 4) is the camera's pose as far as it is known; ``DelayUndetermined`` says what is missing."""
    looks = [look for look in looks if len(look.points) >= FEWEST_POINTS]
    _require(ways, looks)
    scene = _Scene(setup, camera, X, ways, looks)
    theta = scene.solved(scene.start())
    scene = scene.only(scene.steady(theta))
    _require(ways, scene.looks)
    theta = scene.solved(theta)
    off = scene.rms(theta)
    if (far := off > _OUTLIER * np.median(off)).any():
        scene = scene.only(~far)
        _require(ways, scene.looks)
        theta = scene.solved(theta)
    return scene.delay(theta)


def _require(ways: Sequence[Way], looks: Sequence[Look]) -> None:
    seen = {(ways[look.way].pair, ways[look.way].direction) for look in looks}
    pairs = {pair for pair, _ in seen if {(pair, 1), (pair, -1)} <= seen}
    if len(looks) < FEWEST_LOOKS or len(pairs) < FEWEST_PAIRS:
        raise DelayUndetermined(
            f"too-few-pictures: {len(looks)} pictures show the target while the arm moves evenly, on "
            f"{len(pairs)} ways out and back; {FEWEST_LOOKS} on {FEWEST_PAIRS} are needed"
        )


class _Scene:
    """Looks and ways as arrays; unknowns are target and camera (6 each, twists), delay, hysteresis."""

    def __init__(
        self, setup: Setup, camera: Intrinsics, X: Array, ways: Sequence[Way], looks: Sequence[Look]
    ) -> None:
        self.setup, self.camera, self.X, self.ways, self.looks = setup, camera, X, ways, looks
        counts = [len(look.points) for look in looks]
        self.of = np.repeat(np.arange(len(looks)), counts)  # the look of each point
        self.points = np.concatenate([look.points for look in looks])
        self.corners = np.concatenate([look.corners for look in looks])
        rows = np.repeat([look.row_time_s for look in looks], counts) * self.corners[:, 1]
        middle = np.bincount(self.of, rows) / np.bincount(self.of)
        self.t = np.array([look.t for look in looks]) + middle  # of the look's middle row
        self.after = (rows - middle[self.of])[:, None]  # of each point's row, s
        self.way = np.array([look.way for look in looks])
        self._looks_of = {int(k): np.flatnonzero(self.way == k) for k in np.unique(self.way)}
        self.direction = np.array([ways[k].direction for k in self.way], dtype=float)
        self.speed = np.array([ways[k].speed for k in self.way])
        self.B0 = ways[0].T[len(ways[0].T) // 2]
        self.paths = [se3.log(self._relative(way.T)) for way in ways]
        ends = [way.direction * (way.T[-1, :3, 3] - way.T[0, :3, 3]) for way in ways]
        along = np.sum(ends, axis=0)
        along = along / np.linalg.norm(along)
        # By what the target is moved where the flange lags behind.
        self.lag = -along if setup == "eye-to-hand" else self.B0[:3, :3].T @ along

    def only(self, keep: NDArray[np.bool_]) -> "_Scene":
        looks = [look for look, kept in zip(self.looks, keep, strict=True) if kept]
        if not looks:
            raise DelayUndetermined("too-few-pictures: no picture shows the target while the arm moves")
        return _Scene(self.setup, self.camera, self.X, self.ways, looks)

    @property
    def several_speeds(self) -> bool:
        return bool(self.speed.max() > ONE_SPEED * self.speed.min())

    def start(self) -> "_Unknowns":
        """From the picture that is taken nearest to the reference."""
        path = self._path(self.t)
        nearest = int(np.argmin(np.linalg.norm(path[:, :3], axis=1)))
        look = self.looks[nearest]
        view = CornerSet(look.points, look.corners, np.ones(len(look.points)))
        C = solve_pnp([view], self.camera)[0].C[0]
        D = se3.exp(path[nearest])
        return _Unknowns(se3.inverse(D @ self.X) @ self.X @ C, self.X, 0.0, 0.0)

    def solved(self, at: "_Unknowns") -> "_Unknowns":
        """Least squares in the picture, with what is known of the camera as a prior."""
        for _ in range(_STEPS):
            J, r, prior = self._system(at)
            N = J.T @ J + np.diag(prior)
            step = np.asarray(
                np.linalg.solve(N, J.T @ r - prior * at.away(self.X)[: len(prior)]), dtype=float
            )
            at = at.moved(step)
            if abs(step[_TAU]) < _SETTLED_S:
                break
        return at

    def rms(self, at: "_Unknowns") -> Array:
        """(k,) px of each look."""
        square = np.sum((self.corners - self._seen(at)) ** 2, axis=1)
        return np.asarray(np.sqrt(np.bincount(self.of, square) / np.bincount(self.of)))

    def steady(self, at: "_Unknowns") -> NDArray[np.bool_]:
        """Which looks were taken while the arm went at an even speed.

        Between two states of an arm that accelerates its place is not known as well, and it bends.
        """
        t, margin = self.t - at.tau, max(_MARGIN_S, 2.0 * float(np.median(np.diff(self.ways[0].t))))
        before, here, after = (self._path(t + dt)[:, :3] for dt in (-margin, 0.0, margin))
        steps = np.linalg.norm([here - before, after - here], axis=2)
        slower, faster = steps.min(axis=0), steps.max(axis=0)
        begin, end = np.array([self.ways[k].t[[0, -1]] for k in self.way]).T
        inside = (begin + margin < t) & (t < end - margin)
        return np.asarray(inside & (slower > _MOVES * self.speed * margin) & (slower > _EVEN * faster))

    def delay(self, at: "_Unknowns") -> Delay:
        """The delay at the solution, and what leaving out each way out with its way back says of it."""
        J, r, prior = self._system(at)
        pair = np.array([self.ways[k].pair for k in self.way])[self.of]
        left = leave_out(J, r, np.repeat(pair, 2), prior)
        noise = float(r @ r) / max(len(r) - J.shape[1], 1)
        cov = noise * np.linalg.inv(J.T @ J + np.diag(prior))
        sigma = np.sqrt(np.maximum(np.diag(left.cov), np.diag(cov)))
        with_h = self.several_speeds
        return Delay(
            tau=at.tau,
            sigma_tau=float(sigma[_TAU]),
            hysteresis=at.hysteresis if with_h else None,
            sigma_hysteresis=float(sigma[_HYSTERESIS]) if with_h else None,
            residuals=self._along(J[:, _TAU], r),
            heldout=self._along(J[:, _TAU], left.heldout),
            scatter=None,
            sigmas=left.sigmas,
        )

    def _along(self, by_tau: Array, r: Array) -> Array:
        """(k,) m: by how much of the way each look is off."""
        of = np.repeat(self.of, 2)
        late_s = np.bincount(of, by_tau * r) / np.bincount(of, by_tau**2)
        return np.asarray(late_s * self.speed)

    def _system(self, at: "_Unknowns") -> tuple[Array, Array, Array]:
        """Derivatives (2n, p) and residuals (2n,) px, and the precision of the prior (p,) in px^-2."""
        count = _HYSTERESIS + 1 if self.several_speeds else _HYSTERESIS
        seen = self._seen(at)
        J = np.empty((seen.size, count))
        for k in range(count):
            step = np.zeros(count)
            step[k] = _STEP
            J[:, k] = (self._seen(at.moved(step)) - seen).ravel() / _STEP
        r = (self.corners - seen).ravel()
        prior = np.zeros(count)
        noise = float(r @ r) / len(r)
        prior[6:9], prior[9:12] = noise / _CAMERA_M**2, noise / _CAMERA_RAD**2
        return J, r, prior

    def _seen(self, at: "_Unknowns") -> Array:
        """(n, 2) px of every point."""
        middle, later = (self._target(at, self.t - at.tau + dt) for dt in (-_BETWEEN_S, _BETWEEN_S))
        first, last = (self._placed(C) for C in (middle, later))
        p = 0.5 * (first + last) + (last - first) * (self.after / (2.0 * _BETWEEN_S))
        pixels, _ = cv2.projectPoints(
            p, np.zeros(3), np.zeros(3), self.camera.matrix, np.array(self.camera.dist)
        )
        return np.asarray(pixels, dtype=float).reshape(-1, 2)

    def _placed(self, C: Array) -> Array:
        own = C[self.of]
        return np.asarray((own[:, :3, :3] @ self.points[..., None])[..., 0] + own[:, :3, 3])

    def _target(self, at: "_Unknowns", t: Array) -> Array:
        """(k, 4, 4): the target in the camera at ``t`` (k,) s."""
        D = se3.exp(self._path(t))
        lag = np.zeros((len(D), 6))
        lag[:, :3] = 0.5 * at.hysteresis * self.direction[:, None] * self.lag
        shifted = se3.exp(lag)
        D = shifted @ D if self.setup == "eye-to-hand" else D @ shifted
        return np.asarray(se3.inverse(at.X) @ D @ at.X @ at.M)

    def _path(self, t: Array) -> Array:
        """(k, 6): where the flange is relative to the reference, at the time ``t`` (k,) s of each look."""
        out = np.empty((len(t), 6))
        for k, own in self._looks_of.items():
            for j in range(6):
                out[own, j] = np.interp(t[own], self.ways[k].t, self.paths[k][:, j])
        return out

    def _relative(self, T: Array) -> Array:
        if self.setup == "eye-to-hand":
            return np.asarray(T @ se3.inverse(self.B0))
        return np.asarray(se3.inverse(T) @ self.B0)


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """Target from the reference ``M`` and the camera's pose ``X`` (4, 4), ``tau`` s, ``hysteresis`` m."""

    M: Array
    X: Array
    tau: float
    hysteresis: float

    def moved(self, step: Array) -> "_Unknowns":
        """By ``step`` (p,), of 13 or 14 numbers."""
        return _Unknowns(
            se3.exp(step[:6]) @ self.M,
            self.X @ se3.exp(step[6:12]),
            self.tau + float(step[_TAU]),
            self.hysteresis + (float(step[_HYSTERESIS]) if len(step) > _HYSTERESIS else 0.0),
        )

    def away(self, X: Array) -> Array:
        """(p,): how far the numbers with a prior are off its mean."""
        out = np.zeros(_HYSTERESIS + 1)
        out[6:12] = se3.log(se3.inverse(X) @ self.X)
        return out
