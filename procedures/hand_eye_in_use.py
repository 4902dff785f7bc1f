"""The calibrated camera that a run works with, and how good the arm is with the one on its flange."""

from scipy.spatial.transform import RigidTransform

from cell.calibrated_lens import calibrated_lens
from cell.devices import Intrinsics
from cell.errors import error
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


def arm_rms_m(values: RunValues) -> float | None:
    """RMS error (m) of the arm by the model in use: as the calibration of its kinematics left it, or as the
    capture of the hand-eye found it; None where neither says."""
    if in_use(values) is not None:
        found = values.kinematics["arm"] or {}
        rms = found.get("rms_calibrated")
    else:
        rms = values.uncertainty[HAND_EYE].get("arm", {}).get("configured", {}).get("t")
    return None if rms is None else float(rms)
