"""Every job by name."""

from cell.procedure import Procedure
from procedures.belt.calibration import BeltCalibration
from procedures.belt.tracking import BeltTracking
from procedures.cone_capture import ConeCapture
from procedures.iso9283 import Iso9283Test
from procedures.laser.check import LaserCheck
from procedures.laser.reference import LaserReference
from procedures.laser.update import LaserUpdate
from procedures.latency import LatencyCalibration
from procedures.tracker import TrackerSampling

_ALL = (
    ConeCapture,
    LaserReference,
    LaserCheck,
    LaserUpdate,
    TrackerSampling,
    BeltCalibration,
    BeltTracking,
    LatencyCalibration,
    Iso9283Test,
)
JOBS: dict[str, type[Procedure]] = {job.name: job for job in _ALL}
