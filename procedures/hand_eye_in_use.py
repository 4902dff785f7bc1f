"""The calibrated camera that a run works with, and what was found with it of lens, target and arm."""

from collections.abc import Mapping

import numpy as np
from pydantic import TypeAdapter
from scipy.spatial.transform import RigidTransform

from calibration.adjustment.lens_terms import LENS, LensPrior
from cell.calibrated_lens import calibrated_lens
from cell.devices import Intrinsics
from cell.errors import error
from cell.formats.capture import TargetTable
from cell.poses import from_pose6
from cell.run_values import RunValues
from procedures.kinematics_in_use import in_use, made_otherwise

HAND_EYE = "T_flange_camera"


def require_hand_eye(values: RunValues) -> RigidTransform:
    """``T_flange_camera`` of a calibration whose uncertainty is known, made with the arm's model in use.

    ``HAND_EYE_UNKNOWN`` or ``KINEMATICS_DIFFER``.
    """
    if "cov" not in values.uncertainty.get(HAND_EYE, {}):
        raise error("HAND_EYE_UNKNOWN", "no result of cone-capture is in effect for the flange's camera")
    if why := made_otherwise(values, HAND_EYE):
        raise error("KINEMATICS_DIFFER", why)
    known = values.calibration["eye-in-hand"] or {}
    return from_pose6(known["X"])


def solved_lens(values: RunValues, name: str, told: Intrinsics) -> Intrinsics | None:
    """The lens that belongs to the camera's pose ``name``; None where its calibration has none for pictures
    of the size that is ``told``."""
    return calibrated_lens(values.uncertainty.get(name, {}).get("lens"), told)


def solved_lens_sigma(values: RunValues, name: str) -> dict[str, float]:
    """How well the calibration of the camera's pose ``name`` found its lens: ``f``, a share, and ``c_px``,
    px; as its maker knows it where that calibration does not say."""
    cov = values.uncertainty.get(name, {}).get("lens_cov")
    if cov is None:
        usual = LensPrior()
        return {"f": usual.focal, "c_px": usual.centre_px}
    own = np.diag(np.asarray(cov, dtype=float))[-len(LENS) :]  # behind those of the pose
    sigma = dict(zip(LENS, np.sqrt(own).tolist(), strict=True))
    return {"f": sigma["focal"], "c_px": max(sigma["cx"], sigma["cy"])}


def found_size(values: RunValues, name: str, target: str) -> Mapping[str, float] | None:
    """How much larger the board of ``[target.TARGET]`` is printed than configured, as the calibration of the
    camera's pose ``name`` found it: ``x``, ``y``, ``sigma_x``, ``sigma_y``, shares.

    A result has its target as it was configured, without the name. None where it is not this section's as it
    stands now, or that of two sections alike: which of the two boards was seen is not known then.
    """
    stated = values.uncertainty.get(name, {})
    table = TypeAdapter[TargetTable](TargetTable)
    specs = {key: table.validate_python(dict(spec)) for key, spec in values.targets.items()}
    alike = [key for key, spec in specs.items() if spec.model_dump(exclude_none=True) == stated.get("target")]
    return stated.get("target_scale") if alike == [target] else None


def arm_rms_m(values: RunValues, name: str = HAND_EYE) -> float | None:
    """RMS error (m) of the arm by the model in use: as the calibration of its kinematics left it, or as the
    capture of the camera's pose ``name`` found it; None where neither says."""
    if in_use(values) is not None:
        found = values.kinematics["arm"] or {}
        rms = found.get("rms_calibrated")
    else:
        rms = values.uncertainty.get(name, {}).get("arm", {}).get("configured", {}).get("t")
    return None if rms is None else float(rms)
