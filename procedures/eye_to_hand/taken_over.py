"""A target's place on the flange (C), taken over from a capture of the fixed camera that saw it there."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from calibration.adjustment.arm_terms import ArmPrior
from cell.errors import error
from cell.formats.capture import TargetTable
from cell.formats.result import Envelope
from cell.poses import Array, adjoint, from_pose6, to_pose6
from procedures.eye_to_hand.result import AxbcResult
from procedures.hand_eye.result import HandEyeResult

AXES = [1.0, 0.0, 1.0]  # along and about which the numbers of the last link move the flange


@dataclass(frozen=True)
class TakenOver:
    """``T_marker_flange`` (pose6) and its standard deviations along (m) and about (rad) any axis of the
    flange; ``placement`` is the one of the capture that it is of, ``target`` the [target.NAME] section."""

    T_marker_flange: list[float]
    sigma_t_m: float
    sigma_r_rad: float
    placement: str
    target: str


def taken_over(
    result: Envelope, targets: Mapping[str, Mapping[str, Any]], job_target: str | None, placement: str | None
) -> TakenOver:
    """Of a result of cone-capture, setup eye-to-hand; ``placement`` is its last one unless given.

    ``targets`` are the [target.NAME] sections, ``job_target`` is the one of the check, where it is
    configured. ``ARGUMENT_INVALID`` says why a result holds no place for the check.
    """
    if isinstance(result, AxbcResult):
        raise error(
            "ARGUMENT_INVALID",
            "this is a result of the eye-to-hand check itself: with the place that it found, a check of the "
            "same kind would confirm what it was given; take the place of a cone-capture, or measure it",
        )
    if not isinstance(result, HandEyeResult) or result.result is None:
        raise error(
            "ARGUMENT_INVALID",
            f"this is no hand-eye result with an answer but one of {result.kind}; name the run of a "
            'cone-capture, setup = "eye-to-hand"',
        )
    places = result.result.T_flange_target
    if result.inputs.setup != "eye-to-hand" or not places:
        raise error(
            "ARGUMENT_INVALID",
            "the camera of this capture was on the flange, so its target was not; name the run of a "
            'cone-capture, setup = "eye-to-hand"',
        )
    if result.verdict == "fail":
        raise error("ARGUMENT_INVALID", f"this capture failed: {'; '.join(result.reasons)}")
    label = placement if placement is not None else list(places)[-1]
    if label not in places:
        raise error("ARGUMENT_INVALID", f"there is no placement {label}; there is {', '.join(places)}")
    covariances = result.uncertainty.cov_targets or {}
    if not result.uncertainty.covers:
        raise error(
            "ARGUMENT_INVALID",
            f"the covariance of this result, made by method {result.inputs.method}, covers noise alone and "
            "not lens, print and arm; capture again",
        )
    if label not in covariances:
        raise error("ARGUMENT_INVALID", "this result states no covariance of its target; capture again")
    T = from_pose6(places[label])
    A = adjoint(np.asarray(T.as_matrix()))
    cov = A @ np.array(covariances[label]) @ A.T  # of the flange in the target, in the flange's axes
    t, r = covering(cov + last_link(result.result.scale or {}))
    return TakenOver(
        [float(v) for v in to_pose6(T.inv())], t, r, label, _target(result.inputs.target, targets, job_target)
    )


def last_link(scale: Mapping[str, float]) -> Array:
    """(6, 6) how far the true flange may be from the one that serves the arm as configured, which a capture
    has its target on; by the usual errors of a last link, or those found where they are larger (1)."""
    usual, times = ArmPrior(), max([1.0, *scale.values()])
    angle = float(np.linalg.norm([usual.angle, usual.gear, usual.sag]))
    return np.diag(np.concatenate([np.multiply(usual.length, AXES), np.multiply(angle, AXES)]) * times) ** 2


def covering(cov: Array) -> tuple[float, float]:
    """One standard deviation for all axes of the place and one of the rotation, without correlation, that
    state less in no direction than ``cov`` (6, 6) does."""
    t, r = (float(np.sqrt(np.linalg.eigvalsh(part)[-1])) for part in (cov[:3, :3], cov[3:, 3:]))
    units = np.repeat([t, r], 3)
    together = float(np.sqrt(np.linalg.eigvalsh(cov / np.outer(units, units))[-1]))
    return t * together, r * together


def _target(seen: Mapping[str, Any], targets: Mapping[str, Mapping[str, Any]], job_target: str | None) -> str:
    """The section of the target that was seen."""
    table = TypeAdapter[TargetTable](TargetTable)
    was = table.validate_python(dict(seen))
    alike = [name for name, spec in targets.items() if table.validate_python(dict(spec)) == was]
    if not alike:
        raise error(
            "ARGUMENT_INVALID", "the capture saw a target that is no [target.NAME] section as it stands"
        )
    if job_target is not None and job_target not in alike:
        raise error(
            "ARGUMENT_INVALID",
            f"the capture saw target '{alike[0]}', and the check is configured for '{job_target}'",
        )
    return job_target or alike[0]
