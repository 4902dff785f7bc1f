"""Job ``cone-capture``: hand-eye calibration from camera poses on a cone around a board."""

from procedures.cone_capture.config import ConeCaptureConfig
from procedures.cone_capture.procedure import ConeCapture

__all__ = ["ConeCapture", "ConeCaptureConfig"]
