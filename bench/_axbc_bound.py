"""How near a corrected arm can bring a target that a fixed camera saw: what the best estimator leaves.

Unknowns are the camera in the base, the target on the flange, and the arm's links, gears and sag. Their
standard deviations are those that the bench draws from; of the target's place they are those that the data
state, or those that it draws. Derivatives are differences of the simulated arm, so this shares no line with
the estimator that is held against it.
Source: van Trees, Detection, Estimation, and Modulation Theory, part I, 2.4 (bounds with priors).
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.hand_eye import se3
from cell.poses import Array, adjoint
from tests.kit.eye_to_hand_scene import POSE_R, POSE_T, SIGMA_C_R, SIGMA_C_T, EyeToHandScene
from tests.kit.imperfect_cell import ANGLE_PER_M, FLANGE_R, FLANGE_T, MODEL

GEAR_RAD, SAG_RAD = 2e-5, 1e-4  # as a scene draws them
_STEP = 1e-6  # m, rad
_EXACT = 1e-9  # stands for a place without error
_X, _W, _ARM = slice(0, 6), slice(6, 12), slice(12, None)


@dataclass(frozen=True)
class Best:
    """RMS distance (m) of the target that is expected of the best estimator: one that is told how far the
    given place is off (``drawn``), and one that goes by what the data state of it (``stated``)."""

    drawn: float
    stated: float


def best(scene: EyeToHandScene, arm_m: float, C_off: tuple[float, float], Q: Array) -> Best:
    """At joints ``Q`` (k, 6), after the poses of ``scene`` were seen as bare poses are.

    The given place is off by ``C_off`` (m, rad) in directions of chance, and lengths are to ``arm_m``; the
    estimator knows that of the arm.
    """
    seen, arm = _seen(scene), _of_arm(arm_m)
    # A length in a direction of chance is so much along each axis.
    drawn, stated = (
        _of_place(scene, np.repeat(sigma, 3))
        for sigma in (np.array(C_off) / np.sqrt(3.0), np.array([SIGMA_C_T, SIGMA_C_R]))
    )
    # A flange that is brought to where the camera wants it by numbers that are off takes the target with it.
    moved = _off(scene, Q)[:, :3]
    moved[:, :, _W] = 0.0
    out = []
    for told in (drawn, stated):
        information = seen.copy()
        information[_W, _W] += told
        information[_ARM, _ARM] += arm
        # What is told of the place is off by what was drawn.
        varies = information.copy()
        varies[_W, _W] += told @ np.linalg.inv(drawn) @ told - told
        cov = _inverse(information)
        expected = cov @ varies @ cov
        out.append(float(np.sqrt(np.mean(np.einsum("nij,jk,nik->n", moved, expected, moved)))))
    return Best(*out)


def _inverse(N: Array) -> Array:
    """Of numbers in metres and radians, some of them exact, which differ by powers of ten."""
    s = 1.0 / np.sqrt(np.diag(N))
    out: Array = s[:, None] * np.linalg.inv(N * s[:, None] * s) * s
    return out


def _of_arm(arm_m: float) -> Array:
    """Information about the arm's numbers before anything is seen."""
    links = np.where(np.array(MODEL.kinds) == "length", arm_m, ANGLE_PER_M * arm_m)
    return np.diag(np.concatenate([links, np.repeat([GEAR_RAD, SAG_RAD], [24, 3])]) ** -2.0)


def _of_place(scene: EyeToHandScene, sigma: Array) -> Array:
    """(6, 6) information about the target's pose where the given C is off on its right by ``sigma`` (6,)."""
    turned = adjoint(scene.W)
    out: Array = turned.T @ np.diag(np.maximum(sigma, _EXACT) ** -2.0) @ turned
    return out


def _seen(scene: EyeToHandScene) -> Array:
    """Information of the poses that were seen."""
    J = _off(scene, scene.Q)
    turned = adjoint(se3.inverse(scene.W))
    noise = np.diag(np.repeat([POSE_T, POSE_R], 3) ** 2)
    noise = noise + turned @ np.diag(np.repeat([FLANGE_T, FLANGE_R], 3) ** 2) @ turned.T
    out: Array = np.einsum("nik,ij,njl->kl", J, np.linalg.inv(noise), J)
    return out


def _off(scene: EyeToHandScene, Q: Array) -> Array:
    """(n, 6, m): motion of the target, in its own frame, at joints ``Q`` by each unknown."""
    at, cell = scene.marker(Q), scene.cell
    links, count = len(cell.links), 12 + len(cell.links) + len(cell.gear)
    out = np.empty((len(Q), 6, count))
    for k in range(count):
        xi = np.zeros(count)
        xi[k] = _STEP
        of_links, of_gear = np.split(xi[_ARM], [links])
        other = replace(
            scene,
            X=scene.X @ se3.exp(xi[_X]),
            W=scene.W @ se3.exp(xi[_W]),
            cell=replace(cell, links=cell.links + of_links, gear=cell.gear + of_gear),
        )
        out[:, :, k] = se3.log(se3.inverse(at) @ other.marker(Q)) / _STEP
    return out
