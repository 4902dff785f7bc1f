"""How well an arm can be known from pictures of a board: the bound of the whole problem with its priors.

Every corner is an observation. Unknowns are the arm's links, gears and sag, lens, board, the poses of camera
and boards, and how far the flange is off in each picture; their standard deviations are those that the bench
draws from, or those that are stated. Derivatives are differences of the simulated pictures, so the bound
shares no line with the estimator that is held against it.
Source: van Trees, Detection, Estimation, and Modulation Theory, part I, 2.4 (bounds with priors).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.hand_eye import se3
from cell.poses import Array
from tests.kit.imperfect_cell import (
    ANGLE_PER_M,
    CAMERA,
    FLANGE_R,
    FLANGE_T,
    MODEL,
    POINTS,
    PX,
    X_NOMINAL,
    World,
)

LINKS, GEARS, LENS, BOARD = len(MODEL.nominal), 27, 8, 5
ARM_NUMBERS, OF_PICTURES = LINKS + GEARS, LINKS + GEARS + LENS + BOARD
CENTRE = POINTS.mean(axis=0)[:2]
EDGE_M = float(np.linalg.norm(np.ptp(POINTS[:, :2], axis=0))) / 2.0
_STEP = 1e-6  # of an unknown: m, rad, shares; pixels a thousand times as much
_PIXELS = slice(ARM_NUMBERS + 2, ARM_NUMBERS + 4)


@dataclass(frozen=True)
class Drawn:
    """What arms are drawn from and what is stated: standard deviations."""

    length_m: float
    gear_rad: float
    sag_rad: float
    lens: LensPrior
    board: TargetPrior

    def sigma(self) -> Array:
        """(OF_PICTURES,), in the order of the unknowns."""
        links = np.where(np.array(MODEL.kinds) == "length", self.length_m, ANGLE_PER_M * self.length_m)
        gears = np.array([self.gear_rad] * 24 + [self.sag_rad] * 3)
        return np.concatenate([links, gears, self.lens.sigma(), self.board.sigma()])


def bound(cell: World, Q: Array, group: NDArray[np.int64], C: Array, drawn: Drawn, elsewhere: Array) -> float:
    """RMS position error (m) of the flange at joints ``elsewhere`` (k, 6), after the best base and tool.

    Pictures at joints ``Q`` (n, 6) of the boards ``group`` (n,), each seen at about ``C`` (n, 4, 4). It is
    what the best estimator that goes by the priors is expected to leave, for arms as they are drawn, with
    lens and board off by what they are off in ``cell``.
    """
    sigma = drawn.sigma()
    free = np.concatenate([sigma > 0.0, np.ones(6 + 6 * (int(group.max()) + 1), dtype=bool)])
    precision = np.zeros(len(free))
    precision[:OF_PICTURES] = np.where(sigma > 0.0, 1.0 / np.maximum(sigma, _STEP**2) ** 2, 0.0)
    data = _information(cell, Q, group, C)[np.ix_(free, free)]
    P = np.diag(precision[free])
    # scaled to a unit diagonal: metres, radians and pixels differ by powers of ten
    s = 1.0 / np.sqrt(np.diag(data + P))
    cov = s[:, None] * np.linalg.inv((data + P) * s[:, None] * s) * s
    off = np.zeros(len(free))
    off[ARM_NUMBERS:OF_PICTURES] = _off(cell)
    bias = cov @ P @ off[free]
    of_arm = np.diag(np.where(np.arange(len(free)) < ARM_NUMBERS, precision, 0.0)[free])
    expected = cov @ (data + of_arm) @ cov + np.outer(bias, bias)
    J = np.zeros((3 * len(elsewhere), len(free)))
    J[:, :ARM_NUMBERS] = _positions(cell, elsewhere)
    J = J[:, free]
    return float(np.sqrt(np.einsum("ia,ab,ib->", J, expected, J) / len(elsewhere)))


def _off(cell: World) -> Array:
    """(LENS + BOARD,) what lens and board of the cell are off from what is stated of them."""
    f, _, cx, cy = cell.camera.K
    lens = [f / CAMERA.K[0] - 1.0, 0.0, cx - CAMERA.K[2], cy - CAMERA.K[3], 0.0, 0.0, 0.0, 0.0]
    moved = (cell.points - POINTS).reshape(-1)
    board = np.linalg.lstsq(_board_columns().reshape(len(moved), BOARD), moved, rcond=None)[0]
    return np.concatenate([lens, board])


def _board_columns() -> Array:
    """(m, 3, BOARD): how the corners move with the scales in x and y and the three numbers of the bow."""
    off = POINTS[:, :2] - CENTRE
    u, v = (off / EDGE_M).T
    out = np.zeros((len(POINTS), 3, BOARD))
    out[:, 0, 0], out[:, 1, 1] = off.T
    out[:, 2, 2], out[:, 2, 3], out[:, 2, 4] = u * u, u * v, v * v
    return out


def _information(cell: World, Q: Array, group: NDArray[np.int64], C: Array) -> Array:
    """(p, p) of all unknowns: those of the pictures, then the camera's pose and those of the boards."""
    X, F = X_NOMINAL.as_matrix(), cell.true_flange(Q)
    W = np.stack([(F @ X @ C)[group == g][0] for g in range(int(group.max()) + 1)])
    count = OF_PICTURES + 6 + 6 * len(W)

    def pictures(x: Array, shaken: Array) -> Array:
        """(n, 2 m) pixels with the unknowns off by ``x`` (count,) and flanges by ``shaken`` (6,)."""
        flange = _flange(cell, x[:ARM_NUMBERS], Q) @ se3.exp(shaken)
        boards = W @ se3.exp(x[OF_PICTURES + 6 :].reshape(-1, 6))
        seen = se3.inverse(flange @ X @ se3.exp(x[OF_PICTURES : OF_PICTURES + 6])) @ boards[group]
        points = cell.points + _board_columns() @ x[ARM_NUMBERS + LENS : OF_PICTURES]
        return _pixels(cell, x[ARM_NUMBERS : ARM_NUMBERS + LENS], seen, points)

    none = np.zeros(6)
    A = _differences(lambda x: pictures(x, none), count)
    B = _differences(lambda e: pictures(np.zeros(count), e), 6)
    noise = np.array([FLANGE_T] * 3 + [FLANGE_R] * 3)
    V = PX**2 * np.eye(B.shape[1]) + (B * noise**2) @ np.swapaxes(B, 1, 2)
    out: Array = np.sum(np.swapaxes(A, 1, 2) @ np.linalg.solve(V, A), axis=0)
    return out


def _differences(of: Callable[[Array], Array], count: int) -> Array:
    """(n, r, count): derivatives of (n, r) numbers at zero, by central differences."""
    columns = []
    for k in range(count):
        step = np.zeros(count)
        step[k] = _STEP * (1000.0 if _PIXELS.start <= k < _PIXELS.stop else 1.0)
        columns.append((of(step) - of(-step)) / (2.0 * step[k]))
    return np.stack(columns, axis=-1)


def _flange(cell: World, off: Array, Q: Array) -> Array:
    """(k, 4, 4) of the cell's arm with its links and gears off by (ARM_NUMBERS,) more."""
    return replace(cell, links=cell.links + off[:LINKS], gear=cell.gear + off[LINKS:]).true_flange(Q)


def _pixels(cell: World, lens: Array, C: Array, points: Array) -> Array:
    """(n, 2 m) of ``points`` (m, 3) at poses ``C`` (n, 4, 4), with the lens off by (LENS,)."""
    focal, aspect, dx, dy, k1, k2, p1, p2 = lens
    fx, fy, cx, cy = cell.camera.K
    K = np.array([[fx * (1.0 + focal), 0.0, cx + dx], [0.0, fy * (1.0 + focal) * (1.0 + aspect), cy + dy]])
    K = np.vstack([K, [0.0, 0.0, 1.0]])
    dist = np.array(cell.camera.dist)
    dist[:4] += (k1, k2, p1, p2)
    seen = (C[:, None, :3, :3] @ points[:, :, None])[..., 0] + C[:, None, :3, 3]
    pixels, _ = cv2.projectPoints(seen.reshape(-1, 3), np.zeros(3), np.zeros(3), K, dist)
    return np.asarray(pixels, dtype=float).reshape(len(C), -1)


def _positions(cell: World, Q: Array) -> Array:
    """(3 k, ARM_NUMBERS): how the flange's places move, beyond one base and one tool offset."""
    T = _flange(cell, np.zeros(ARM_NUMBERS), Q)
    J = _differences(lambda x: _flange(cell, x, Q)[:, :3, 3], ARM_NUMBERS).reshape(3 * len(Q), -1)
    R, places = T[:, :3, :3], T[:, :3, 3]
    own = np.concatenate([np.tile(np.eye(3), (len(Q), 1, 1)), -se3.hat(places), R], axis=2)
    own = own.reshape(3 * len(Q), 9)
    return np.asarray(J - own @ np.linalg.lstsq(own, J, rcond=None)[0])
