"""A sampling of an arm on a twin: of the one that we move, or of one that is only read."""

from cell.errors import present
from cell.known_cell import KnownObserved, KnownReflector
from procedures.laser_tracker.rehearsal import rehearse_with_tracker
from procedures.rehearsal import Rehearsal, cannot, needed
from procedures.setup import Setup
from procedures.tracker.config import TrackerSamplingConfig


def rehearse_sampling(setup: Setup, job: TrackerSamplingConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    if job.with_set is not None:
        raise cannot(
            "with_set is a set of the true arm, and a twin has another one; leave it out to rehearse"
        )
    observed = None if job.arm == "arm" else _observed(setup, job)
    reflectors = {
        name: KnownReflector(
            r.point, observed=observed is not None, normal=r.normal, half_angle_rad=r.half_angle_rad
        )
        for name, r in job.reflectors.items()
    }
    reflectors |= {name: KnownReflector(m.point, monument=True) for name, m in job.monuments.items()}
    return rehearse_with_tracker(setup, None, job.T_base_tracker_nominal, reflectors, observed)


def _observed(setup: Setup, job: TrackerSamplingConfig) -> KnownObserved:
    """The arm that is only read: nobody but its own program or a person moves it."""
    needed(setup, "observed_arm")
    if not setup.values.observed_robot:
        raise cannot("[robot] observed_model is missing; give the ROBOT of the observed arm as a JSON file")
    device = setup.devices[setup.roles["observed_arm"]]
    by_person = not getattr(device, "allow_requests", False)
    ranges = present(job.joint_ranges_rad, "joint_ranges_rad of an observed arm")
    return KnownObserved(setup.values.observed_robot, ranges, by_person)
