"""Which part of a cell has changed: tool, camera, or a joint's zero, or none, or who can tell.

The cell is measured twice: a target before the camera, then and now, and the tool in the beams, now against
then; a tracker may have seen the arm of now, and the tool's point may have stood over a target that the
camera of now has located. All of it is one adjustment with the camera's pose and the numbers of arm and lens
as common unknowns, those of the lens only where both captures are of one lens; a change of the tool, of the
camera or of one joint's zero is an unknown with a prior that says: nothing happened. A hypothesis is that the
prior of one part is wrong, and wide instead. What hypotheses are worth is their marginal likelihood (the
evidence of MacKay 1992; a score test where one of them is far ahead), in which a part with many unknowns pays
for them. A change that is constant to the tool, constant to the base, or varying with the joints shows as
such in both measurements together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.adjustment.arm_accuracy import camera_on_true_arm
from calibration.adjustment.arm_by_tracker import SeenArm
from calibration.adjustment.hand_eye import Adjusted
from calibration.adjustment.lens_terms import LensPrior
from calibration.adjustment.touch import SeenTouch
from calibration.adjustment.unknowns import GEARS, GEOMETRY, LENS_BLOCK, ArmKnown, arm_terms
from calibration.hand_eye import se3
from cell.poses import Array

NONE, TOOL, CAMERA, JOINT, SEVERAL = "none", "tool", "camera", "joint", "several"
Part = Literal["none", "tool", "camera", "joint zero", "cannot-tell"]
SURE = 0.975  # 40 to 1 that a part has changed, alone or with another: then it is named
_ALONE = 0.9  # 10 to 1 at least that it was alone
# Standard deviations of a change that happened, and of what changes in a cell to which nothing happened.
_TOOL_M, _CAMERA_M, _CAMERA_RAD, _JOINT_RAD = 2e-3, 3e-3, 3e-3, 3e-3
_STILL_M, _STILL_RAD = 1e-5, 1e-5
# What a lens at a fixed focus differs by from one capture to the next. Pictures drift by some 0.14 px for a
# degree ("Modeling and Compensation Method of Camera Temperature Drift Effect", Acta Optica Sinica 2024: 7 px
# for 50 degrees), and warm cameras differ by two degrees or so: an assumption, as what goes with it is.
LENS_STILL = LensPrior(focal=1e-4, aspect=1e-5, centre_px=0.3, radial=3e-4, tangential=3e-5)
_UNKNOWN = 10.0  # m and rad, of the camera's pose itself
_BEFOREHAND = {NONE: 0.4, TOOL: 0.19, CAMERA: 0.19, JOINT: 0.19, SEVERAL: 0.03}  # two at once are rare
_SEEN = 0.3  # of a joint zero's wide prior: a zero that is left more open shows in nothing
_POSE = 6


@dataclass(frozen=True)
class SeenCamera:
    """What one capture says of the camera ``X`` (4, 4), for the arm's true base and flange, and of the
    ``numbers`` (a + l,): first those of the arm, then the ``lens`` ones of the lens: all of them or none.
    ``cov`` (6 + a + l, 6 + a + l) is theirs, X in its own frame, with the ``prior`` (a + l,) standard
    deviations of the numbers in it."""

    X: Array
    numbers: Array
    cov: Array
    prior: Array
    lens: int = 0

    @property
    def arm(self) -> Array:
        """(a,) the numbers of the arm."""
        return self.numbers[: len(self.numbers) - self.lens]


@dataclass(frozen=True)
class SeenTool:
    """By how much the tool's point has moved on the flange (3,) m as beams show it, with ``cov`` (3, 3), and
    ``by_joints`` (3, j): how far it seems to for a unit of each joint's zero."""

    moved: Array
    cov: Array
    by_joints: Array


@dataclass(frozen=True)
class CrossChecked:
    """The ``part`` that has changed, and which ``joint`` (from 0) where it is a zero; how ``probable`` each
    hypothesis is; and, were it the most probable one, the ``change`` with its standard deviations ``sigma``:
    m for a tool (3,), m and rad for a camera (6,), rad for a joint (1,). ``unseen`` are joints whose zero
    shows in nothing that was measured, ``by_beams_alone`` those which nothing parts from a bent tool."""

    part: Part
    joint: int | None
    probable: Mapping[str, float]
    change: Array
    sigma: Array
    unseen: tuple[int, ...]
    by_beams_alone: tuple[int, ...] = ()


def seen_camera(found: Adjusted, arm: ArmKnown, lens: LensPrior | None = None) -> SeenCamera:
    """From an adjustment, with the motions of base and flange put back that the arm's errors contain.

    ``lens`` is the prior that its lens had, where the other capture is of the same lens, given as the same.
    """
    terms = arm_terms(arm, arm.Q[:1])
    scale = {name: found.components.scale.get(name, 1.0) for name in (GEOMETRY, GEARS)}
    prior = np.concatenate([scale[name] * t.sigma for name, t in terms.items()])
    a = len(prior)
    rows = np.arange(a)
    if lens is not None:
        rows = np.concatenate([rows, np.arange(len(found.names))[found.blocks[LENS_BLOCK]]])
        prior = np.concatenate([prior, lens.sigma()])
    moved, by_numbers = camera_on_true_arm(found, arm)
    J = np.eye(_POSE + len(rows))
    J[:_POSE, _POSE : _POSE + a] = by_numbers
    cross = found.cross[:, rows]
    cov = np.block([[found.cov, cross], [cross.T, found.cov_numbers[np.ix_(rows, rows)]]])
    return SeenCamera(moved @ found.X, found.numbers[rows], J @ cov @ J.T, prior, len(rows) - a)


def cross_check(
    then: SeenCamera,
    now: SeenCamera,
    tool: SeenTool | None,
    names: Sequence[str],
    arm: SeenArm | None = None,
    touch: SeenTouch | None = None,
) -> CrossChecked:
    """``names`` begins with those of the arm's numbers; the zero of joint k is the number ``theta<k + 1>``.
    Both captures have the numbers of the lens, or none has.
    ``arm``: what a tracker tells of the arm of now; ``touch``: a touch test, by the adjustment of ``now``."""
    joints = [k for k in range(len(names)) if f"theta{k + 1}" in names]
    cell = _Cell(then, now, tool, [list(names).index(f"theta{k + 1}") for k in joints], arm, touch)
    hypotheses = cell.hypotheses()
    evidence = {name: cell.evidence(sigma) for name, (sigma, _) in hypotheses.items()}
    best = max(evidence.values())
    weight = {name: share * float(np.exp(evidence[name] - best)) for name, (_, share) in hypotheses.items()}
    total = sum(weight.values())
    grouped = dict.fromkeys(_BEFOREHAND, 0.0)
    for name, value in weight.items():
        grouped[name.split()[0]] += value / total
    kind = max(grouped, key=lambda name: grouped[name])
    single = max((n for n in weight if n.split()[0] == kind), key=lambda n: weight[n])
    change, cov = cell.change(hypotheses[single][0], kind, single)
    joint = int(single.split()[1]) if kind == JOINT else None
    own = single.split()[-1]  # as hypotheses of several parts have it
    with_another = sum(weight[n] for n in weight if n.split()[0] == SEVERAL and own in n.split()[1:]) / total
    sure = grouped[kind] >= _ALONE and grouped[kind] + with_another >= SURE
    part: Part = "cannot-tell"
    if kind != SEVERAL and sure and joint not in cell.by_beams_alone:
        part = "joint zero" if kind == JOINT else kind  # type: ignore[assignment]
    if part != "joint zero":
        joint = None
    return CrossChecked(
        part, joint, grouped, change, np.sqrt(np.diag(cov)), cell.unseen, tuple(sorted(cell.by_beams_alone))
    )


class _Cell:
    """Unknowns: the camera's pose then (6), the numbers of arm and lens then (a + l), and the changes since:
    camera (6), tool (3), zeros of the joints (j), lens (l). What is measured says ``information`` and
    ``pull`` of them."""

    def __init__(
        self,
        then: SeenCamera,
        now: SeenCamera,
        tool: SeenTool | None,
        zeros: Sequence[int],
        arm: SeenArm | None,
        touch: SeenTouch | None,
    ) -> None:
        a, j, lens_count = len(then.arm), len(zeros), then.lens
        common_count = _POSE + a + lens_count
        self.camera = slice(common_count, common_count + _POSE)
        self.tool = slice(self.camera.stop, self.camera.stop + 3)
        self.joint = slice(self.tool.stop, self.tool.stop + j)
        lens = slice(self.joint.stop, self.joint.stop + lens_count)
        count = lens.stop
        common = np.concatenate([np.full(_POSE, _UNKNOWN), then.prior])
        self.prior = np.concatenate([common, np.full(count - len(common), np.nan)])
        first = np.eye(common_count, count)
        second = first.copy()
        second[:_POSE, self.camera] = np.eye(_POSE)
        second[[_POSE + k for k in zeros], np.arange(self.joint.start, self.joint.stop)] = 1.0
        second[_POSE + a :, lens] = np.eye(lens_count)
        self.information, self.pull = np.zeros((count, count)), np.zeros(count)
        m = np.zeros(0)
        for seen, A in ((then, first), (now, second)):
            m = np.concatenate([se3.log(se3.inverse(then.X) @ seen.X), seen.numbers])
            N = _inverse(seen.cov)
            own = N.copy()
            own[_POSE:, _POSE:] -= np.diag(seen.prior**-2.0)
            self.information += A.T @ own @ A
            self.pull += A.T @ (N @ m)
        if arm is not None:
            A = second[_POSE : _POSE + a]
            self.information += A.T @ arm.information @ A
            self.pull += A.T @ arm.pull
        if tool is not None:
            A = np.zeros((3, count))
            A[:, self.tool] = np.eye(3)
            A[:, self.joint] = tool.by_joints[:, :j]
            W = np.linalg.inv(tool.cov)
            self.information += A.T @ W @ A
            self.pull += A.T @ W @ tool.moved
        if touch is not None:  # nothing would be off, were the cell as it truly is and not as it was found
            A = touch.by_cell @ second[: _POSE + a]
            A[:, self.tool] += touch.by_tool
            W = np.linalg.inv(touch.cov)
            self.information += A.T @ W @ A
            self.pull += A.T @ W @ (touch.by_cell @ m[: _POSE + a] - touch.off)

        self.still = self.prior.copy()
        self.still[self.camera] = [_STILL_M] * 3 + [_STILL_RAD] * 3
        self.still[self.tool], self.still[self.joint] = _STILL_M, _STILL_RAD
        self.still[lens] = LENS_STILL.sigma()[:lens_count]
        self.unseen = tuple(k for k in range(j) if self._left_open(k) > _SEEN)
        # What one place in the beams shows of these, a tool that is bent in that direction shows as well.
        alone = {k for k in range(j) if self._left_open(k, tool=True) > _SEEN}
        self.by_beams_alone = alone - set(self.unseen)

    def _left_open(self, k: int, tool: bool = False) -> float:
        """The share of a joint zero's wide prior that is left, also where the ``tool`` may have changed."""
        M, _ = self._posed(self._wide(joint=k, tool=tool))
        at = self.joint.start + k
        return float(np.sqrt(np.linalg.inv(M)[at, at]))

    def _wide(self, camera: bool = False, tool: bool = False, joint: int | None = None) -> Array:
        """Prior standard deviations of all unknowns with some parts that may have changed."""
        sigma = self.still.copy()
        if camera:
            sigma[self.camera] = [_CAMERA_M] * 3 + [_CAMERA_RAD] * 3
        if tool:
            sigma[self.tool] = _TOOL_M
        if joint is not None:
            sigma[self.joint.start + joint] = _JOINT_RAD
        return sigma

    def hypotheses(self) -> dict[str, tuple[Array, float]]:
        """Prior standard deviations of all unknowns and how probable it is beforehand, by name."""
        wide = self._wide
        joints = [k for k in range(self.joint.stop - self.joint.start) if k not in self.unseen]
        several = {f"{SEVERAL} camera tool": wide(True, True)}
        for k in joints:
            several[f"{SEVERAL} camera {k}"] = wide(camera=True, joint=k)
            several[f"{SEVERAL} tool {k}"] = wide(tool=True, joint=k)
        each = {NONE: {NONE: self.still}, TOOL: {TOOL: wide(tool=True)}, CAMERA: {CAMERA: wide(camera=True)}}
        each |= {JOINT: {f"{JOINT} {k}": wide(joint=k) for k in joints}, SEVERAL: several}
        return {
            name: (sigma, _BEFOREHAND[kind] / len(own))
            for kind, own in each.items()
            for name, sigma in own.items()
        }

    def evidence(self, sigma: Array) -> float:
        """Logarithm of the marginal likelihood, up to a constant."""
        M, y = self._posed(sigma)
        sign, det = np.linalg.slogdet(M)
        return float(-0.5 * det + 0.5 * y @ np.linalg.solve(M, y)) if sign > 0 else -np.inf

    def change(self, sigma: Array, kind: str, name: str) -> tuple[Array, Array]:
        """What has changed under a hypothesis, and its covariance."""
        M, y = self._posed(sigma)
        z = sigma * np.linalg.solve(M, y)
        cov = sigma[:, None] * np.linalg.inv(M) * sigma
        part = {TOOL: self.tool, CAMERA: self.camera}.get(kind, slice(0, 0))
        if kind == JOINT:
            k = self.joint.start + int(name.split()[1])
            part = slice(k, k + 1)
        return z[part], cov[part, part]

    def _posed(self, sigma: Array) -> tuple[Array, Array]:
        """The equations in units of the prior."""
        M = np.eye(len(sigma)) + self.information * sigma[:, None] * sigma
        return 0.5 * (M + M.T), sigma * self.pull


def _inverse(cov: Array) -> Array:
    scale = 1.0 / np.sqrt(np.diag(cov))
    inverse = np.linalg.inv(cov * scale[:, None] * scale)
    return np.asarray(0.5 * (inverse + inverse.T) * scale[:, None] * scale)
