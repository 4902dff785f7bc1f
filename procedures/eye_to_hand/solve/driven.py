"""What the camera saw at targets that the arm was driven to after the answer."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from calibration.adjustment.hand_eye import LaterPoses, later_poses
from calibration.hand_eye import se3
from cell.errors import error
from cell.formats.axbc import AxbcArrival, AxbcDriven
from cell.poses import Array, adjoint, from_pose6
from procedures.eye_to_hand.result import DrivenTarget, DrivenTargets, SeenAtTarget
from procedures.eye_to_hand.solve.answer import Found, place_of
from procedures.eye_to_hand.solve.data import AxbcData
from procedures.eye_to_hand.words import gain_text, move_text
from procedures.hand_eye.solve.capture import CaptureSet
from procedures.hand_eye.solve.solver import measurements

LOST, NOT_BETTER, NOT_RETURNED = "targets.lost", "targets.not-better", "targets.not-returned"
_RADIUS95 = float(np.sqrt(chdtri(3, 0.05)))  # of a normal 3-vector, in its largest standard deviation
_SURE = 2.0  # standard deviations by which the squared distances must be less
_MEANING = (
    "95 % by corners, lens and print as they were found, and the target's place on the flange; the last "
    "three are the share that is common to all targets, and more views do not lower it. An error of a lens "
    "that is taken as it is given is in none of it, and neither heading nor tilt is judged"
)


@dataclass(frozen=True)
class _Off:
    """Of n arrivals: ``d`` (n, 3) m in the camera by which the target was off. Its error is of each with
    covariance ``own`` (n, 3, 3), and ``J`` (n, 3, c) times one of all with ``common`` (c, c). ``repeats``
    (n, 3, 3) is by how well the arm comes to a pose again: no error of ``d``, but chance in what it shows."""

    arrivals: list[AxbcArrival]
    d: Array
    own: Array
    J: Array
    common: Array
    repeats: Array

    @property
    def shared(self) -> Array:
        """(n, 3, 3): by what is common to all."""
        out: Array = self.J @ self.common @ self.J.swapaxes(1, 2)
        return out

    def pairs(self) -> NDArray[np.int64]:
        """(m, 2) rows of targets that were seen both as given and corrected."""
        row = {(a.target, a.how): k for k, a in enumerate(self.arrivals)}
        both = [
            (k, row[target, "corrected"])
            for (target, how), k in row.items()
            if how == "given" and (target, "corrected") in row
        ]
        return np.array(both, dtype=np.int64).reshape(-1, 2)

    def gain(self, pairs: NDArray[np.int64]) -> tuple[float, float]:
        """By how much the corrected squared distances are less in sum, m^2, and its standard deviation over
        further visits."""
        sign = np.repeat([[1.0, -1.0]], len(pairs), axis=0).ravel()
        rows = pairs.ravel()
        slope = 2.0 * sign[:, None] * self.d[rows]
        by_common = np.einsum("ni,nic->c", slope, self.J[rows])
        variance = np.einsum("ni,nij,nj->", slope, self.own[rows] + self.repeats[rows], slope)
        variance += by_common @ self.common @ by_common
        return float(sign @ np.sum(self.d[rows] ** 2, axis=1)), float(np.sqrt(variance))


def driven_targets(data: AxbcData, found: Found) -> DrivenTargets | None:
    """Each target with what was off there; None where none was to be driven to."""
    driven, arrived = data.document.driven, data.arrived
    if driven is None or arrived is None:
        return None
    rows = arrived.usable()
    off = _off(data, found, driven, arrived, rows) if len(rows) else None
    seen = {} if off is None else _each(off)
    targets = [
        DrivenTarget(
            number=k + 1,
            T_camera_flange=target.T_camera_flange,
            given=target.given,
            corrected=target.corrected,
            before=seen.get((k, "given")),
            after=seen.get((k, "corrected")),
        )
        for k, target in enumerate(driven.targets)
    ]
    unseen = [
        f"{move_text(a.target, a.how)}: {arrived.unusable[row]}"
        for row, a in enumerate(driven.arrivals)
        if row in arrived.unusable
    ]
    lost = [*driven.lost, *unseen]
    out = DrivenTargets(way=driven.way, targets=targets, meaning=_MEANING, lost=lost)
    if driven.stands is not None:
        out = out.changed(stands=driven.stands)
    if off is None or not len(pairs := off.pairs()):
        return out
    gain, sigma = off.gain(pairs)
    before, after = (np.sqrt(np.mean(np.sum(off.d[column] ** 2, axis=1))) for column in pairs.T)
    return out.changed(
        before_rms_m=float(before), after_rms_m=float(after), better=bool(gain > _SURE * sigma)
    )


def driven_warnings(driven: DrivenTargets) -> list[tuple[str, str]]:
    """What is to be said of them: those that were not measured, and a correction that is of no use."""
    out = []
    if driven.lost:
        out.append((LOST, f"not all targets could be measured: {'; '.join(driven.lost)}"))
    if driven.stands is not None:
        out.append((NOT_RETURNED, driven.stands))
    if driven.better is False:
        out.append((NOT_BETTER, gain_text(driven)))
    return out


def _each(off: _Off) -> dict[tuple[int, str], SeenAtTarget]:
    whole, common = _radius(off.own + off.shared), _radius(off.shared)
    return {
        (a.target, a.how): SeenAtTarget(
            q=a.seen.q,
            off_m=float(np.linalg.norm(d)),
            off=d.tolist(),
            off_95_m=float(most),
            common_95_m=float(shared),
        )
        for a, d, most, shared in zip(off.arrivals, off.d, whole, common, strict=True)
    }


def _radius(cov: Array) -> Array:
    """(n,) m: 95 % of errors with ``cov`` (n, 3, 3) are shorter."""
    out: Array = _RADIUS95 * np.sqrt(np.maximum(np.linalg.eigvalsh(cov)[:, -1], 0.0))
    return out


def _off(
    data: AxbcData, found: Found, driven: AxbcDriven, arrived: CaptureSet, rows: NDArray[np.int64]
) -> _Off:
    arrivals = [driven.arrivals[k] for k in rows]
    wanted = [driven.targets[a.target].T_camera_flange for a in arrivals]
    there = np.array([se3.matrices(from_pose6(T)) for T in wanted]) @ place_of(data, found)
    place_cov = found.alone.cov_W if found.place_doubted else data.place.cov
    seen = _measured(found, arrived, rows, there)
    c = seen.moves.shape[2]
    common = np.zeros((c + 3, c + 3))
    common[:c, :c], common[c:, c:] = seen.common, place_cov[:3, :3]
    # The place of the origin of a pose that is moved on its left.
    at = np.concatenate([np.tile(np.eye(3), (len(rows), 1, 1)), -se3.hat(seen.C[:, :3, 3])], axis=2)
    return _Off(
        arrivals,
        seen.C[:, :3, 3] - there[:, :3, 3],
        at @ seen.cov @ at.swapaxes(1, 2),
        np.concatenate([at @ seen.moves, -there[:, :3, :3]], axis=2),
        common,
        _repeats(found, there),
    )


def _repeats(found: Found, there: Array) -> Array:
    """(n, 3, 3) m^2 of targets at poses ``there`` (n, 4, 4): by the noise of the flange, as it was found."""
    noise = found.solution.noise if found.images is None else found.images.components
    t, r = (noise.sigma.get(key, 0.0) for key in ("sigma_flange_t", "sigma_flange_r"))
    lever = se3.hat(there[:, :3, :3] @ se3.inverse(found.standard.W)[:3, 3])
    return t**2 * np.eye(3) + r**2 * lever @ lever.swapaxes(1, 2)


def require_one_kind(path: Path, arrived: CaptureSet, with_views: bool) -> None:
    """``DATA_INVALID`` for an arrival that was not measured as the observations were: from bare poses the
    errors of lens and print are unknown, which would state too small an uncertainty."""
    kinds = ("corners or images", "a bare T_camera_marker")
    for row in arrived.usable().tolist():
        has_view = arrived.views[row] is not None
        if has_view == with_views:
            continue
        own, theirs = kinds if has_view else kinds[::-1]
        raise error(
            "DATA_INVALID",
            f"{path}: driven.arrivals[{row}].seen has {own} and the observations have {theirs}; give "
            f"{theirs} there too, or leave the arrival out",
        )


def _measured(found: Found, arrived: CaptureSet, rows: NDArray[np.int64], near: Array) -> LaterPoses:
    measured = measurements(arrived, rows)
    views = [view for view in measured.views if view is not None]
    if found.images is not None:
        return later_poses(found.images, views, near, measured.motions)
    sigma = [found.solution.noise.sigma.get(key, 0.0) for key in ("sigma_pose_t", "sigma_pose_r")]
    # The noise of a bare pose is told for its own frame.
    A = adjoint(measured.C)
    cov = A @ np.diag(np.repeat(sigma, 3) ** 2) @ A.swapaxes(1, 2)
    return LaterPoses(measured.C, cov, np.zeros((len(rows), 6, 0)), np.zeros((0, 0)))
