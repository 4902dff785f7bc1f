"""A laser tracker or total station on a twin: near its nominal place, as noisy as its section says, and the
reflectors near theirs."""

from collections.abc import Mapping, Sequence

from cell.known_cell import KnownObserved, KnownReflector, KnownTracker
from procedures.laser_tracker.noise import stated_noise
from procedures.rehearsal import Rehearsal, cannot, joints, needed
from procedures.setup import Setup


def rehearse_with_tracker(
    setup: Setup,
    look: str | None,
    T_base_tracker: Sequence[float] | None,
    reflectors: Mapping[str, KnownReflector],
    observed: KnownObserved | None = None,
) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks; without ``observed`` the arm is the one that we
    move."""
    needed(setup, "arm", "tracker")
    if T_base_tracker is None:
        raise cannot("T_base_tracker_nominal of the job says where the twin's tracker would stand; give it")
    noise, _ = stated_noise(setup)
    single = getattr(setup.devices[setup.roles["tracker"]], "measure_with", "") == "single"
    tracker = KnownTracker(list(T_base_tracker), reflectors, noise["sigma0"], noise["sigma_per_m"], single)
    return Rehearsal(joints(setup, look)[0], tracker=tracker, observed=observed)
