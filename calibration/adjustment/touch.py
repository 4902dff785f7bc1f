"""What a touch test tells of a cell whose camera, arm, lens and target one adjustment has as unknowns.

The target's pose in the camera at the look depends on the lens and on the print. What the capture leaves
open of these goes together with what it leaves open of the camera's pose and of the arm: what is expected of
lens and print, given camera and arm, is in the derivatives, and what stays open of them is noise.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.adjustment.arm_accuracy import camera_on_true_arm, true_flange
from calibration.adjustment.hand_eye import Adjusted
from calibration.adjustment.lens_terms import LENS, image_terms
from calibration.adjustment.unknowns import LENS_BLOCK, TARGET_BLOCK, ArmKnown
from calibration.hand_eye.pnp import solve_pnp
from calibration.hand_eye.views import CornerSet
from calibration.touch import Standing, over_points, points_off
from cell.poses import Array

_X = 6


@dataclass(frozen=True)
class Touches:
    """The arm's joints (rad) at the look (6,) and at k points (k, 6); the ``view`` of the target at the look;
    ``points`` (k, 3) m of the target as designed, over which the tool's point stood at ``stand_off_m``.

    ``tool`` (3,) m is its place on the flange as it was when all was well, known to ``tool_m`` per axis;
    ``stand_m`` is how well it stood there, and ``arm_m`` how well the arm comes to rest, per axis.
    """

    q_look: Array
    Q: Array
    view: CornerSet
    points: Array
    stand_off_m: float
    tool: Array
    tool_m: float
    stand_m: float
    arm_m: float


@dataclass(frozen=True)
class SeenTouch:
    """``off`` (3k,) m is what tool, camera and arm together err by at the points, with ``cov`` (3k, 3k);
    ``by_cell`` (3k, 6 + a) is what a change of the camera's pose and of the arm's numbers adds to it, and
    ``by_tool`` (3k, 3) what one of the tool's point on the flange does."""

    off: Array
    cov: Array
    by_cell: Array
    by_tool: Array


def seen_touch(of: Touches, found: Adjusted, arm: ArmKnown, px: float) -> SeenTouch:
    """From the adjustment ``found`` of a capture with the same camera and target. ``px`` is the noise of a
    corner."""
    a = found.blocks[LENS_BLOCK].start  # the arm's numbers come first
    lens = slice(a, len(found.names))
    printed = found.numbers[found.blocks[TARGET_BLOCK]]
    view = replace(of.view, points=found.shape.moved(of.view.points, printed))
    poses, _ = solve_pnp([view], found.camera)
    C = poses.C[0]
    moved, camera_by_numbers = camera_on_true_arm(found, arm)
    X = moved @ found.X
    F, columns = true_flange(found, arm, np.vstack([of.q_look, of.Q]))
    designed = over_points(of.points, C, of.stand_off_m)
    places = found.shape.moved(designed, printed)
    at = points_off(Standing(F[0], F[1:], X, C, of.tool, places))
    by_numbers = at.by_flange @ columns[1:] + at.by_look @ columns[0]
    by_cell = np.concatenate([at.by_camera, by_numbers], axis=2)
    by_lens = at.by_camera @ image_terms([view], poses.C[:1], found.camera, found.shape).moves[0]
    by_lens[:, :, len(LENS) :] -= found.shape.columns(designed)

    # The capture's unknowns, camera and arm in the arm's true base and flange.
    J = np.eye(_X + a)
    J[:_X, _X:] = camera_by_numbers
    whole = np.block([[found.cov, found.cross], [found.cross.T, found.cov_numbers]])
    first, rest = slice(0, _X + a), slice(_X + a, _X + lens.stop)
    cell = J @ whole[first, first] @ J.T
    together = J @ whole[first, rest]
    follows = np.linalg.solve(cell, together).T
    left = whole[rest, rest] - follows @ together

    k = len(of.points)
    G, L, D = (part.reshape(3 * k, -1) for part in (at.by_camera, by_lens, at.by_tool))
    still = np.diag([of.arm_m**2] * 3 + [0.0] * 3)
    look = at.by_look.reshape(3 * k, 6)
    cov = L @ left @ L.T + G @ (px**2 * poses.cov[0]) @ G.T + look @ still @ look.T
    cov += of.tool_m**2 * D @ D.T + (of.stand_m**2 + of.arm_m**2) * np.eye(3 * k)
    return SeenTouch(at.off.ravel(), cov, by_cell.reshape(3 * k, -1) + L @ follows, D)
