"""Every job by name."""

from cell.procedure import Procedure
from procedures.cone_capture import ConeCapture
from procedures.laser.check import LaserCheck
from procedures.laser.reference import LaserReference
from procedures.laser.update import LaserUpdate
from procedures.latency import LatencyCalibration
from procedures.tracker import TrackerSampling

_ALL = (ConeCapture, LaserReference, LaserCheck, LaserUpdate, TrackerSampling, LatencyCalibration)
JOBS: dict[str, type[Procedure]] = {job.name: job for job in _ALL}
