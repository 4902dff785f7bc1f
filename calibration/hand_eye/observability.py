"""What a set of poses cannot determine, found before anything is solved, by name and in words."""

from dataclasses import dataclass

import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.problem import Problem, Setup
from cell.poses import Array

_SAME_T, _SAME_R = 2e-5, 2e-5  # m, rad: two poses closer than this are one
_TURN = 0.01  # rad: RMS rotation about an axis below which nothing is seen of it
_NOISE_MARGIN = 4.0


@dataclass(frozen=True)
class Refusal:
    """A fixed ``name`` and the unobservable direction in ``words``."""

    name: str
    words: str

    def __str__(self) -> str:
        return f"{self.name}: {self.words}"


@dataclass(frozen=True)
class Rotations:
    """How the arm turned, groups pooled: RMS angle ``rms`` (3,) about the ``axes`` (3, 3, columns).

    Largest first; the axes are in the frame that X maps to (flange, or base for eye-to-hand).
    """

    rms: Array
    axes: Array

    def as_dict(self, setup: Setup) -> dict[str, object]:
        """For the result."""
        return {
            "rotation_rms_rad": self.rms.tolist(),
            "rotation_axes": self.axes.T.tolist(),
            "axes_frame": axes_frame(setup),
        }


def axes_frame(setup: Setup) -> str:
    """The frame in which relative rotations of the arm are expressed."""
    return "flange" if setup == "eye-in-hand" else "base"


def rotations(problem: Problem) -> Rotations:
    """Scatter of the arm's rotations about the mean of their group."""
    scatter = np.zeros((3, 3))
    count = 0
    for g in range(problem.groups):
        R = problem.G[problem.group == g][:, :3, :3]
        mean = se3.mean_rotation(R)
        T = np.tile(np.eye(4), (len(R), 1, 1))
        T[:, :3, :3] = R @ mean.T
        w = se3.log(T)[:, 3:]
        scatter += w.T @ w
        count += len(R)
    values, axes = np.linalg.eigh(scatter / max(count, 1))
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


def angle_mismatch(problem: Problem) -> float:
    """Median difference (rad) of the angles that arm and camera turned by between neighbours of a group.

    It does not depend on X: when it is large the flange poses do not belong to the images.
    """
    i = np.flatnonzero(problem.group[:-1] == problem.group[1:])
    if len(i) == 0:
        return 0.0
    turned = []
    for T in (problem.G, problem.C):
        trace = np.sum(T[i, :3, :3] * T[i + 1, :3, :3], axis=(1, 2))
        turned.append(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
    return float(np.median(np.abs(turned[0] - turned[1])))


def _distinct(problem: Problem) -> int:
    """Number of poses that differ, counted inside each group."""
    count = 0
    for g in range(problem.groups):
        kept: list[Array] = []
        for G in problem.G[problem.group == g]:
            if len(kept) < 8 and all(_apart(G, other) for other in kept):
                kept.append(G)
        count += len(kept)
    return count


def _apart(A: Array, B: Array) -> bool:
    xi = se3.log(A @ se3.inverse(B))
    return bool(np.linalg.norm(xi[:3]) > _SAME_T or np.linalg.norm(xi[3:]) > _SAME_R)


def _rolls_with_target(problem: Problem) -> bool:
    """Whether the one axis is the target's normal, with the target at rest in the camera otherwise."""
    for g in range(problem.groups):
        C = problem.C[problem.group == g]
        normals = C[:, :3, 2]
        mean = normals.mean(axis=0)
        if np.linalg.norm(mean) < np.cos(np.radians(3.0)):
            return False
    return True


def _words(axis: Array) -> str:
    a = axis * np.sign(axis[np.argmax(np.abs(axis))])
    name = "xyz"[int(np.argmax(a))]
    near = f"near {name}, " if a.max() > 0.9 else ""
    return f"{near}[{a[0]:.3f}, {a[1]:.3f}, {a[2]:.3f}]"
