"""What a set of poses cannot determine, found before anything is solved, by name and in words."""

from dataclasses import dataclass

import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.problem import Problem, Setup
from calibration.refusal import Refusal
from cell.poses import Array

_SAME_T, _SAME_R = 2e-5, 2e-5  # m, rad: two poses closer than this are one
_TURN = 0.01  # rad: RMS rotation about an axis below which nothing is seen of it
_NOISE_MARGIN = 4.0
_SAME_NORMAL, _SAME_POINT, _NEAR_AXIS = np.radians(3.0), 0.04, 0.5  # rad, and shares of the distance


@dataclass(frozen=True)
class Rotations:
    """How the arm turned, groups pooled: RMS angle ``rms`` (3,) about the ``axes`` (3, 3, columns).

    Largest first; the axes are in the frame that X maps to (flange, or base for eye-to-hand).
    """

    rms: Array
    axes: Array


def axes_frame(setup: Setup) -> str:
    """The frame in which relative rotations of the arm are expressed."""
    return "flange" if setup == "eye-in-hand" else "base"


def rotations(problem: Problem) -> Rotations:
    """Scatter of the arm's rotations about the mean of their group."""
    member = (problem.group == np.arange(problem.groups)[:, None]).astype(float)
    R = problem.G[:, :3, :3]
    means = se3.nearest_rotation((member @ R.reshape(-1, 9)).reshape(-1, 3, 3))
    w = se3.rotation_vectors(R @ np.swapaxes(means[problem.group], 1, 2))
    values, axes = np.linalg.eigh(w.T @ w / max(problem.n, 1))
    return Rotations(np.sqrt(np.maximum(values[::-1], 0.0)), axes[:, ::-1])


def refuse(problem: Problem, sigma_flange_r: float = 0.0) -> Refusal | None:
    """Why this set cannot give X, or None when it can."""
    X = "T_flange_camera" if problem.setup == "eye-in-hand" else "T_base_camera"
    n, distinct = problem.n, _distinct(problem)
    if n == 0:
        return Refusal("too-few-poses", f"no observation can be used, so nothing of {X} is observable")
    if n >= 2 and distinct == 1:
        return Refusal(
            "poses-not-distinct", f"all {n} flange poses are equal, so nothing of {X} is observable"
        )
    relative = distinct - problem.groups
    if relative < 2:
        return Refusal(
            "too-few-poses",
            f"{distinct} distinct poses in {problem.groups} placement(s) give {max(relative, 0)} relative "
            f"motion(s), two about different axes are needed; the translation of {X} is not observable",
        )
    found = rotations(problem)
    limit = max(_TURN, _NOISE_MARGIN * sigma_flange_r)
    frame = axes_frame(problem.setup)
    if found.rms[0] < limit:
        return Refusal(
            "no-rotation",
            f"the arm turned by no more than {np.degrees(found.rms[0]):.2f} deg (RMS) between the poses, so "
            f"all three directions of the translation of {X} are unobservable; turn the flange by 20 deg "
            "or more about two axes",
        )
    if found.rms[1] < limit:
        axis = _words(found.axes[:, 0])
        detail = (
            f"all rotations are about one axis, {axis} in the {frame} frame, so the translation of {X} "
            "along that axis is unobservable"
        )
        if _rolls_with_target(problem):
            return Refusal(
                "rigid-roll",
                f"the camera turned rigidly about the target's normal at a fixed tilt; {detail}; let the "
                "camera keep its roll on the cone",
            )
        return Refusal("parallel-axes", f"{detail}; add poses that turn about another axis")
    return None


def still_pairs(problem: Problem, limit: float = 0.0087) -> list[tuple[int, int, float]]:
    """Consecutive rows of one group whose attitudes differ by less than ``limit`` rad, with the angle."""
    i = np.arange(problem.n - 1)
    R = problem.G[:, :3, :3]
    trace = np.sum(R[:-1] * R[1:], axis=(1, 2))
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    rows = i[(problem.group[:-1] == problem.group[1:]) & (angle < limit)]
    return [(int(k), int(k) + 1, float(angle[k])) for k in rows]


def _distinct(problem: Problem) -> int:
    """Number of poses that differ, counted inside each group up to three: more makes no difference."""
    left, count = np.arange(problem.n), 0
    for _ in range(3):
        groups, first, place = np.unique(problem.group[left], return_index=True, return_inverse=True)
        count += len(groups)
        G, one = problem.G[left], problem.G[left[first]][place]
        shift = np.linalg.norm(G[:, :3, 3] - one[:, :3, 3], axis=1)
        turn = np.linalg.norm(G[:, :3, :3] - one[:, :3, :3], axis=(1, 2)) / np.sqrt(2.0)
        left = left[(shift > _SAME_T) | (turn > _SAME_R)]
    return count


def _rolls_with_target(problem: Problem) -> bool:
    """Whether the one axis is the target's normal through the point that the camera looks at.

    That is the cone whose camera turns with its generatrix: in every placement the normal and one point of
    the target's plane rest in the camera, the point well inside the view.
    """
    for g in range(problem.groups):
        C = problem.C[problem.group == g]
        if np.linalg.norm(C[:, :3, 2].mean(axis=0)) < np.cos(_SAME_NORMAL):
            return False
        # R_i c + t_i = p for one c in the plane z = 0 and one p in the camera
        A = np.concatenate([C[:, :3, :2], np.tile(-np.eye(3), (len(C), 1, 1))], axis=2).reshape(-1, 5)
        b = -C[:, :3, 3].ravel()
        found = np.linalg.lstsq(A, b, rcond=None)[0]
        p = found[2:]
        wander = np.sqrt(np.mean((A @ found - b) ** 2))
        if wander > _SAME_POINT * p[2] or np.linalg.norm(p[:2]) > _NEAR_AXIS * p[2]:
            return False
    return True


def _words(axis: Array) -> str:
    a = axis * np.sign(axis[np.argmax(np.abs(axis))])
    name = "xyz"[int(np.argmax(a))]
    near = f"near {name}, " if a.max() > 0.9 else ""
    return f"{near}[{a[0]:.3f}, {a[1]:.3f}, {a[2]:.3f}]"
