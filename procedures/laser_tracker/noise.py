"""The noise of a tracker as its section states it."""

from procedures.setup import Setup
from procedures.words import mm

TRACKER = {"sigma0": 15e-6, "sigma_per_m": 6e-6}  # of today's trackers, where the driver's section is silent


def stated_noise(setup: Setup) -> tuple[dict[str, float], str]:
    """The noise of the cell's tracker as its section states it, else that of today's, and which in words."""
    section = setup.devices[setup.roles["tracker"]]
    sigma0, slope = (getattr(section, key, None) for key in ("sigma0_m", "sigma_per_m"))
    if sigma0 is None or slope is None:
        return TRACKER, "a tracker of 0.015 mm + 0.006 mm/m assumed"
    return {"sigma0": sigma0, "sigma_per_m": slope}, f"a tracker of {mm(sigma0)} + {mm(slope)}/m"
