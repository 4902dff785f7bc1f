"""A laser tracker or total station on a twin: near its nominal place, as noisy as its section says, and the
reflectors near theirs."""

from collections.abc import Mapping, Sequence
from typing import Any

from cell.known_cell import KnownObserved, KnownReflector, KnownTracker
from procedures.laser_tracker.noise import stated_noise
from procedures.rehearsal import Rehearsal, cannot, joints, needed
from procedures.setup import Setup


def _asked_hz(section: Any) -> float | None:
    """How often the instrument is asked for a reading; None where it sends them by itself."""
    period_s = getattr(section, "poll_period_s", None)
    return None if period_s is None or getattr(section, "request", "") is None else 1.0 / period_s


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
    section = setup.devices[setup.roles["tracker"]]
    tracker = KnownTracker(
        list(T_base_tracker),
        reflectors,
        noise["sigma0"],
        noise["sigma_per_m"],
        one_by_one=getattr(section, "measure_with", "") == "single",
        rate_hz=_asked_hz(section),
    )
    return Rehearsal(joints(setup, look)[0], tracker=tracker, observed=observed)
