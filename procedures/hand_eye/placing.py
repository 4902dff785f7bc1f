"""Where the target is to be placed next: what the operator is asked for, and whether it was placed anew."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.hand_eye.problem import Setup
from calibration.targets import make_target
from cell.poses import from_pose6
from procedures.hand_eye.config import ConeCaptureConfig
from procedures.hand_eye.plan import BoardObservation, camera_to_target
from procedures.words import deg, mm


@dataclass(frozen=True)
class Placement:
    """Placement ``number`` (from 0) of a capture; ``base`` and ``tilt`` (from 0) where it has bases."""

    number: int
    base: int | None = None
    tilt: int = 0

    @classmethod
    def of(cls, config: ConeCaptureConfig, number: int) -> "Placement":
        if config.bases is None:
            return cls(number)
        return cls(number, *divmod(number, config.tilts))


def placement_text(config: ConeCaptureConfig, place: Placement, problem: str, known: str) -> str:
    """What the operator is asked for: the next placement, or what to do about the ``problem`` of this one.

    ``known``: how well the answer is known so far, in words.
    """
    where = f"Placement {place.number + 1} of {config.placements}"
    if place.base is not None:
        where += f" (base {place.base + 1} of {config.bases}, tilt {place.tilt + 1} of {config.tilts})"
    if problem:
        return f"{where}: {problem}, then confirm. Or skip the placement, or finish with what there is."
    text = f"{where}: {_wanted(config, place)}, in view of the camera, then confirm."
    return f"{text} ({known[0].upper()}{known[1:]}.)" if known else text


def _wanted(config: ConeCaptureConfig, place: Placement) -> str:
    in_hand = config.setup == "eye-in-hand"
    if place.number == 0:
        return "put the board on its stand" if in_hand else "mount the board on the flange"
    if place.base is not None and place.tilt > 0:
        return "tilt the board on its stand" if in_hand else "tilt the board on its bracket"
    if place.base is not None:
        return (
            "move the stand to another place"
            if in_hand
            else "move the bracket to another place on the flange"
        )
    what = "move the board" if in_hand else "remount the board on the flange"
    return f"{what} to another place with another tilt"


@dataclass(frozen=True)
class Likeness:
    """How little a target has moved since it stood in placement ``group``: m, and rad."""

    group: int
    t: float
    r: float

    def text(self, number: int) -> str:
        """``number``: of that placement, counted from 1."""
        return (
            f"the board has not moved since placement {number} (it stands {mm(self.t)} and {deg(self.r)} "
            "from there), and a second look at one place tells nothing new"
        )


def likeness(
    setup: Setup,
    target: Mapping[str, Any],
    calibration: Mapping[str, Any],
    now: BoardObservation,
    before: Mapping[int, BoardObservation],
    limits: tuple[float, float],
) -> Likeness | None:
    """The placement of ``before`` that the target as seen ``now`` is like: within both ``limits`` (m, rad).

    The camera's pose ``calibration["X"]`` matters only where the arm stood elsewhere then.
    """
    points = make_target(target).points
    X = from_pose6(calibration.get("X", np.zeros(6)))

    def place(view: BoardObservation) -> RigidTransform:
        flange = from_pose6(view.T_base_flange)
        return (flange if setup == "eye-in-hand" else flange.inv()) * X * camera_to_target(view, points)

    here = place(now)
    found = []
    for group, view in before.items():
        step = place(view).inv() * here
        found.append(Likeness(group, float(np.linalg.norm(step.translation)), step.rotation.magnitude()))
    like = [f for f in found if f.t < limits[0] and f.r < limits[1]]
    return min(like, key=lambda f: f.t, default=None)
