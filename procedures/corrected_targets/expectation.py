"""What ``cellward check`` expects of targets for an observed arm: what is missing or out of reach."""

from typing import Any

import numpy as np

from calibration.identification.application import chain_of
from cell.calibrations import kinematics
from cell.errors import CellError
from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.corrected_targets.plan import joints_of, wanted
from procedures.setup import Setup


def targets_expectation(setup: Setup, job: CorrectedTargetsConfig) -> dict[str, Any]:
    """``text`` and what was found. Reach is looked at with the controller's own model, from ``q_near``."""
    roles = ("observed_arm",) if job.reflector is None else ("observed_arm", "tracker")
    if missing := setup.missing(*roles):
        return {"text": missing[0], "problems": missing[:1], "cautions": []}
    if not setup.values.observed_robot:
        text = "[robot] observed_model is missing; give the ROBOT of the observed arm as a JSON file"
        return {"text": text, "problems": [text], "cautions": []}
    chain = chain_of(setup.values.observed_robot)
    try:
        goals, _ = wanted(job, chain.joints)
        if job.q_near is not None:
            near = np.array(job.q_near, dtype=float)
            joints_of(chain, goals, np.tile(near, (len(goals), 1)), "the controller's own model")
    except CellError as exc:
        return {"text": f"no plan: {exc}", "problems": [f"{exc}. {exc.hint}"], "cautions": []}
    name = kinematics(setup.roles["observed_arm"])
    cautions = []
    if not any((r["name"], r["state"]) == (name, "committed") for r in setup.calibrations()):
        cautions.append(f"no {name} is accepted; run tracker-sampling with arm = 'observed_arm' first")
    ways = "as given and corrected" if job.as_given else "corrected"
    seen = "the joints alone" if job.reflector is None else f"a tracker at {job.reflector}"
    return {
        "text": f"{len(goals)} targets {ways}, seen by {seen}",
        "problems": [],
        "cautions": cautions,
    }
