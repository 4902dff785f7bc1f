"""What an AXB = C solution tells: the standard, what was given against it, and the map of the workspace."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_about import arm_with
from calibration.adjustment.hand_eye import Adjusted
from calibration.adjustment.mount import PLACE_DOUBTED, GivenPose, Mounted, for_controller
from calibration.adjustment.mount import Suspicion as GivenSuspicion
from calibration.adjustment.shared_errors import SharedErrors
from calibration.adjustment.target_correction import ChosenWay, plain_mean
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Solution
from calibration.kinematics.families import robot_document
from cell.formats.result import Rejected
from cell.poses import Array, adjoint
from procedures.eye_to_hand.result import (
    AxbcAnswer,
    AxbcResiduals,
    MappedPose,
    NoiseFound,
    OnCorrectedArm,
    PlaceOff,
    PoseSize,
    Positioning,
    Suspicion,
    TargetCorrection,
)
from procedures.eye_to_hand.solve.data import AxbcData
from procedures.hand_eye.solve.arm import GivenArm
from procedures.hand_eye.solve.result import pose6

ARM_WORSE = 3.0  # times its prior: no arm of that kind


@dataclass(frozen=True)
class Found:
    """``alone`` is what the images and the arm say, ``judged`` how what was given agrees with it, and
    ``standard`` is that with the target's known place, unless the place is doubted.

    ``solution`` has the target's poses as the lens and the print found have them, ``F`` (k, 4, 4) and ``C``
    (k, 4, 4) are flange and T_camera_target of the used observations ``rows`` (k,). ``images`` is what was
    found of lens and print; None without images.
    """

    solution: Solution
    rows: NDArray[np.int64]
    F: Array
    arm: ArmKnown | SharedErrors
    alone: Mounted
    judged: GivenSuspicion
    standard: Mounted
    images: Adjusted | None = None

    @property
    def place_doubted(self) -> bool:
        return self.judged.blamed in PLACE_DOUBTED

    @property
    def C(self) -> Array:
        return self.solution.problem.C[self.rows]


def place_of(data: AxbcData, found: Found) -> Array:
    """T_flange_target (4, 4) that figures are told with: as given, or as found where that is doubted."""
    return found.alone.W if found.place_doubted else data.place.T


def constant_of(data: AxbcData, found: Found) -> Array:
    """T_base_camera (4, 4) that corrects targets by one constant."""
    return plain_mean(found.F, found.C, place_of(data, found))


def answer_of(data: AxbcData, found: Found, choice: ChosenWay, arm: GivenArm | None) -> AxbcAnswer:
    standard = found.standard
    T, cov = _base_in_camera(for_controller(standard))
    given = se3.inverse(data.camera.T)
    off = se3.log(se3.inverse(T) @ given)
    robot = adjusted = None
    if arm is not None and isinstance(found.arm, ArmKnown):
        corrected, values = arm_with(standard.numbers, found.arm)
        robot = robot_document(arm.spec, corrected, values, arm.spec.tools)
        on_arm, cov_on_arm = _base_in_camera(standard)
        adjusted = OnCorrectedArm(T_camera_base=pose6(on_arm), cov=cov_on_arm.tolist())
    places, positioning = _positioning(data, found)
    judged = found.judged
    beyond = max(found.alone.scale.values(), default=0.0) > ARM_WORSE
    return AxbcAnswer(
        T_camera_base=pose6(T),
        direction="base in camera",
        cov=cov.tolist(),
        mean=pose6(se3.inverse(plain_mean(found.F, found.C, data.place.T))),
        eval=_lengths(off),
        eval_sigma=_along(off, cov),
        C_offset=_place_off(data.place, found.alone),
        blamed="arm" if judged.blamed == "none" and beyond else judged.blamed,
        suspicion=Suspicion(X=judged.X, C=judged.W, both=judged.both),
        positioning=positioning,
        places=places,
        correction=_correction(data, found, choice),
        robot=robot,
        adjusted=adjusted,
        scale={k: float(v) for k, v in found.alone.scale.items()},
        noise=NoiseFound.model_validate(found.solution.noise.as_dict()),
        rejected=[
            Rejected(index=data.seen.indices[k], reason=reason)
            for k, reason in sorted(_left_out(data, found).items())
        ],
    )


def _correction(data: AxbcData, found: Found, choice: ChosenWay) -> TargetCorrection:
    constant = constant_of(data, found)
    return TargetCorrection(
        chosen=choice.chosen,
        **{f"cv_{way}": rms for way, rms in choice.cv.items()},
        shift=pose6(constant @ se3.inverse(data.camera.T)),
        T_base_camera=pose6(constant),
    )


def _base_in_camera(found: Mounted) -> tuple[Array, Array]:
    """T_camera_base (4, 4) and its covariance (6, 6)."""
    A = adjoint(found.X)
    return se3.inverse(found.X), A @ found.cov_X @ A.T


def _left_out(data: AxbcData, found: Found) -> dict[int, str]:
    rows = data.seen.usable()
    return dict(data.seen.unusable) | {int(rows[k]): text for k, text in found.solution.reasons.items()}


def _lengths(xi: Array) -> PoseSize:
    return PoseSize(t=float(np.linalg.norm(xi[:3])), r=float(np.linalg.norm(xi[3:])))


def _along(xi: Array, cov: Array) -> PoseSize:
    """Standard deviations of the lengths of ``xi``, along it; the largest one where it is zero."""
    out = {}
    for key, part in (("t", slice(0, 3)), ("r", slice(3, 6))):
        size = float(np.linalg.norm(xi[part]))
        own = cov[part, part]
        variance = xi[part] @ own @ xi[part] / size**2 if size > 0.0 else np.linalg.eigvalsh(own)[-1]
        out[key] = float(np.sqrt(variance))
    return PoseSize(**out)


def _place_off(given: GivenPose, alone: Mounted) -> PlaceOff:
    """How far the target's place is from the given one, as a motion of T_marker_flange on its right."""
    C, found = se3.inverse(given.T), se3.inverse(alone.W)
    A = adjoint(alone.W)
    off = se3.log(se3.inverse(C) @ found)
    size = _lengths(off)
    return PlaceOff(
        t=size.t,
        r=size.r,
        xi=off.tolist(),
        cov=(A @ alone.cov_W @ A.T).tolist(),
        T_marker_flange=pose6(found),
    )


def _positioning(data: AxbcData, found: Found) -> tuple[list[MappedPose], Positioning]:
    """The flange through the given camera against the reported one, pose by pose."""
    seen = data.camera.T @ found.C @ se3.inverse(place_of(data, found))
    off = se3.log(se3.inverse(found.F) @ seen)
    apart = seen[:, :3, 3] - found.F[:, :3, 3]
    rows = data.seen.usable()[found.rows]
    places = [
        MappedPose(
            index=data.seen.indices[int(row)],
            p=F[:3, 3].tolist(),
            d=d.tolist(),
            r=float(np.linalg.norm(xi[3:])),
        )
        for row, F, d, xi in zip(rows, found.F, apart, off, strict=True)
    ]
    rms = Positioning(
        t_rms=float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))),
        r_rms=float(np.sqrt(np.mean(np.sum(off[:, 3:] ** 2, axis=1)))),
    )
    return places, rms


def residuals_of(found: Found) -> AxbcResiduals:
    distance = found.solution.distance[found.rows]
    return AxbcResiduals(
        meaning="how far observations are from the plain solution, in units of its noise; no accuracy",
        distance_rms=float(np.sqrt(np.mean(distance**2))),
        excess=float(found.solution.excess),
    )


def arm_text(alone: Mounted) -> str:
    most = max(alone.scale, key=lambda block: alone.scale[block])
    return (
        f"the arm's errors ({most}) are {alone.scale[most]:.1f} times what is usual of an arm: look at its "
        "joint zeros and its factory calibration before the camera is judged"
    )
