"""What ``cellward check`` expects of targets for an observed arm: what is missing or out of reach."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calibration.identification.application import chain_of
from cell.calibrations import kinematics
from cell.errors import CellError
from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.corrected_targets.joint_ranges import JointRanges, outside_text
from procedures.corrected_targets.plan import branch_of, needs_joints, plan_targets, wanted
from procedures.setup import Setup


def targets_expectation(setup: Setup, job: CorrectedTargetsConfig) -> dict[str, Any]:
    """``text`` and what was found. Reach is looked at with the accepted kinematics, without any with the
    controller's own model alone."""
    roles = ("observed_arm",) if job.reflector is None else ("observed_arm", "tracker")
    if missing := setup.missing(*roles):
        return {"text": missing[0], "problems": missing[:1], "cautions": []}
    if not setup.values.observed_robot:
        text = "[robot] observed_model is missing; give the ROBOT of the observed arm as a JSON file"
        return {"text": text, "problems": [text], "cautions": []}
    name = kinematics(setup.roles["observed_arm"])
    accepted = setup.committed(name)
    cautions: list[str] = []
    try:
        if accepted is None:
            cautions.append(f"no {name} is accepted; run tracker-sampling with arm = 'observed_arm' first")
            _require_reached(setup, job)
        else:
            _require_planned(setup, job, accepted["value"], cautions)
    except CellError as exc:
        return {"text": f"no plan: {exc}", "problems": [f"{exc}. {exc.hint}"], "cautions": []}
    ways = "as given and corrected" if job.as_given else "corrected"
    seen = "the joints alone" if job.reflector is None else f"a tracker at {job.reflector}"
    return {
        "text": f"{len(job.targets)} targets {ways}, seen by {seen}",
        "problems": [],
        "cautions": cautions,
    }


def _require_reached(setup: Setup, job: CorrectedTargetsConfig) -> None:
    """By the controller's own model, within the ranges that will be sampled; ``TARGETS_UNREACHABLE``."""
    chain = chain_of(setup.values.observed_robot or {})
    goals, _ = wanted(job, chain.joints)
    ranges = JointRanges.of({"joint_ranges_rad": setup.observed_ranges()})
    near = ranges.middle if job.q_near is None else np.array(job.q_near, dtype=float)
    if near is not None:
        branch_of(chain, goals, near, ranges)


def _require_planned(
    setup: Setup, job: CorrectedTargetsConfig, found: Mapping[str, Any], cautions: list[str]
) -> None:
    """By the kinematics ``found``, with what they do not cover among the ``cautions``."""
    values = replace(setup.values, kinematics={"observed_arm": found})
    if needs_joints(values, job):
        wanted(job, chain_of(found["robot"]).joints)
        Q = np.zeros((0, 0))
    else:
        Q = np.array([t.corrected for t in plan_targets(values, job.model_dump(), [])])
    if text := outside_text(Q, range(1, len(Q) + 1), JointRanges.of(found).sampled):
        cautions.append(text)
