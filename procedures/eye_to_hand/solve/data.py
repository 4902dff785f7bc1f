"""An AXB = C data set in memory: a capture of one placement, and what was given of camera and target."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.adjustment.mount import GivenPose
from calibration.hand_eye import se3
from cell.formats.axbc import SCHEMA, AxbcObservation, AxbcSet, SigmaPose
from cell.formats.capture import SCHEMA as CAPTURE_SCHEMA
from cell.formats.capture import Capture, Observation, Points
from cell.formats.reading import parse, read_json
from cell.poses import Array, adjoint, from_pose6
from procedures.hand_eye.solve.capture import CaptureSet, measured_capture
from procedures.solving import Progress

FILE_NAME = "axbc.json"
SIGMA_C = SigmaPose(t=1e-4, r=3e-4)  # of a machined bracket and a marker glued to a stop
SIGMA_X = SigmaPose(t=2e-4, r=3e-4)  # of a good hand-eye calibration

NOT_JUDGED = {  # by where the target's place comes from
    "drawing": "",
    "hand-eye": ", taken over from a hand-eye capture: what is wrong alike in that capture and in the given "
    "hand-eye (lens, print, arm) is not judged, only what has changed since",
}


@dataclass(frozen=True)
class AxbcData:
    """``seen`` are the observations as a capture; ``camera`` T_base_camera and ``place`` T_flange_target as
    given, with their covariances; ``known`` says where these come from. ``arrived`` is what was seen at
    targets that the arm was driven to."""

    document: AxbcSet
    seen: CaptureSet
    camera: GivenPose
    place: GivenPose
    known: dict[str, str]
    arrived: CaptureSet | None = None


def load_axbc(path: Path, progress: Progress | None = None) -> AxbcData:
    """Read and check a data set (its folder or its JSON file); an ``InputError`` names file and field."""
    file = path / FILE_NAME if path.is_dir() else path
    document = parse(AxbcSet, read_json(file), SCHEMA, str(file))
    sigma_C, sigma_X = document.sigma_C or SIGMA_C, document.sigma_X or SIGMA_X
    C = se3.matrices(from_pose6(document.T_marker_flange))
    X = se3.matrices(from_pose6(document.X_measured_T_camera_base))
    known = {
        "C": _source("sigma_C", sigma_C, document.sigma_C is None) + NOT_JUDGED[document.C_from],
        "X_measured": _source("sigma_X", sigma_X, document.sigma_X is None),
    }
    return AxbcData(
        document,
        measured_capture(file, _capture(document, document.observations), progress),
        GivenPose(se3.inverse(X), _square(sigma_X)),  # a camera is off at the camera, not at the base
        _inverted(C, _square(sigma_C)),
        known,
        None
        if document.driven is None
        else measured_capture(file, _capture(document, [a.seen for a in document.driven.arrivals])),
    )


def _capture(document: AxbcSet, observations: Sequence[AxbcObservation]) -> Capture:
    """``observations`` as of one placement of a target on the flange."""
    return Capture.model_validate(
        {
            "schema": CAPTURE_SCHEMA,
            "setup": "eye-to-hand",
            "camera": document.camera,
            "target": document.marker or Points(type="points", points=[[0.0, 0.0, 0.0]]),
            "noise": document.noise,
            "robot": document.robot,
            "observations": [_observation(k, o) for k, o in enumerate(observations)],
        }
    )


def _observation(k: int, seen: AxbcObservation) -> Observation:
    own = seen.model_dump(exclude={"index", "T_camera_marker"})
    index = k if seen.index is None else seen.index
    return Observation.model_validate({**own, "index": index, "T_camera_target": seen.T_camera_marker})


def _inverted(T: Array, cov: Array) -> GivenPose:
    """The inverse of a pose ``T exp(xi)``, and its covariance."""
    A = adjoint(T)
    return GivenPose(se3.inverse(T), A @ cov @ A.T)


def _square(sigma: SigmaPose) -> Array:
    return np.diag(np.maximum(np.repeat([sigma.t, sigma.r], 3), 1e-9) ** 2)


def _source(key: str, sigma: SigmaPose, default: bool) -> str:
    text = f"{1e3 * sigma.t:g} mm, {1e3 * sigma.r:g} mrad"
    return f"default ({text})" if default else f"{key} ({text})"
