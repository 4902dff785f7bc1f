"""A test of pose accuracy and repeatability on a twin."""

from cell.known_cell import KnownReflector
from procedures.iso9283.config import Iso9283Config
from procedures.laser_tracker.rehearsal import rehearse_with_tracker
from procedures.rehearsal import Rehearsal
from procedures.setup import Setup


def rehearse_test(setup: Setup, job: Iso9283Config) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    reflectors = {job.reflector: KnownReflector(job.point)}
    return rehearse_with_tracker(setup, job.near, job.T_base_tracker_nominal, reflectors)
