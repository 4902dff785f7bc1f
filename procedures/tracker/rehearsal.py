"""A sampling of an arm on a twin."""

from cell.known_cell import KnownReflector
from procedures.laser_tracker.rehearsal import rehearse_with_tracker
from procedures.rehearsal import Rehearsal, cannot
from procedures.setup import Setup
from procedures.tracker.config import TrackerSamplingConfig


def rehearse_sampling(setup: Setup, job: TrackerSamplingConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks; an arm that is only read is not rehearsed."""
    if job.arm != "arm":
        raise cannot("an observed arm is moved by its own program, which no twin has; nothing to rehearse")
    if job.with_set is not None:
        raise cannot(
            "with_set is a set of the true arm, and a twin has another one; leave it out to rehearse"
        )
    reflectors = {
        name: KnownReflector(r.point, normal=r.normal, half_angle_rad=r.half_angle_rad)
        for name, r in job.reflectors.items()
    }
    reflectors |= {name: KnownReflector(m.point, monument=True) for name, m in job.monuments.items()}
    return rehearse_with_tracker(setup, None, job.T_base_tracker_nominal, reflectors)
