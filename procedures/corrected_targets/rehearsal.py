"""Targets that are handed to an arm on a twin, which is sampled with the tracker first."""

from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.rehearsal import Rehearsal, cannot, joints, needed
from procedures.setup import Setup

BEFORE = ("tracker-sampling",)


def rehearse_targets(setup: Setup, job: CorrectedTargetsConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks; tracker and arm are those of the sampling."""
    needed(setup, "arm", "observed_arm", "tracker")
    if job.reflector is None:
        raise cannot(
            "without a reflector no tracker looks, and the twin's truth cannot judge what the joints say"
        )
    return Rehearsal(joints(setup, None)[0], before=BEFORE, same_arm=True)
