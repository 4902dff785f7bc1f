"""What the images say against the target that was given: its size, its flatness, its side."""

import numpy as np

from calibration.adjustment.hand_eye import Adjusted
from calibration.adjustment.lens_terms import TargetPrior
from calibration.adjustment.unknowns import TARGET_BLOCK
from calibration.hand_eye.problem import Problem
from procedures.hand_eye.solve.capture import CaptureSet

SCALE, FLATNESS, MIRRORED = "target.scale", "target.flatness", "target.mirrored"
_BEYOND_SCALE, _BEYOND_BOW = 2.0, 3.0  # times what was known before
_SURE = 4.0  # times its own standard deviation
_FRONT = {"charuco": 1.0, "aruco-marker": -1.0}  # z of the target seen from the front, along the view


def target_warnings(found: Adjusted, prior: TargetPrior, factor: float) -> list[tuple[str, str]]:
    """Where the target is not what was given, beyond what was to be expected of it.

    ``factor``: the target of the adjustment is so many times as large as the one that was given.
    """
    part = found.blocks[TARGET_BLOCK]
    numbers, sigma = found.numbers[part].copy(), found.sigma[part].copy()
    numbers[:2], sigma[:2] = factor * (1.0 + numbers[:2]) - 1.0, factor * sigma[:2]
    sure = np.abs(numbers) > _SURE * sigma
    out = []
    if np.any(sure[:2] & (np.abs(numbers[:2]) > _BEYOND_SCALE * prior.scale)):
        x, y = (f"{100 * v:+.2f} % (± {200 * s:.2f} %)" for v, s in zip(numbers[:2], sigma[:2], strict=True))
        out.append(
            (
                SCALE,
                f"the target's size is not the given one: {x} along x and {y} along y, 95 %; the result "
                "takes it into account: measure the target over many squares and correct its lengths",
            )
        )
    if np.any(sure[2:] & (np.abs(numbers[2:]) > _BEYOND_BOW * prior.bow)):
        far = 1e3 * float(np.abs(numbers[2:]).max())
        out.append(
            (
                FLATNESS,
                f"the target is not flat: it is bent by {far:.2f} mm at its edge; the result takes a bow "
                "into account, no other shape: mount it on something stiff",
            )
        )
    return out


def side_warnings(loaded: CaptureSet, problem: Problem) -> list[tuple[str, str]]:
    """Where most images show a target from behind: its numbering is mirrored."""
    front = _FRONT.get(loaded.capture.target.type)
    if front is None or not problem.n:
        return []
    along = front * np.sum(problem.C[:, :3, 2] * problem.C[:, :3, 3], axis=1)
    behind = int(np.sum(along < 0.0))
    if behind <= problem.n // 2:
        return []
    return [
        (
            MIRRORED,
            f"{behind} of {problem.n} images show the target from behind: the numbering of its corners is "
            "mirrored; the camera's pose does not depend on it, the target's does",
        )
    ]
