"""What ``cellward check`` expects of a tracker sampling: which poses are possible, and how well they tell."""

from typing import Any

from cell.errors import AbortError, CellError
from cell.poses import Array
from procedures.laser_tracker.noise import stated_noise
from procedures.setup import Setup
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import make_space, payload_of, robot_of
from procedures.tracker.plan import PlanRequest, plan_sampling
from procedures.tracker.plan_words import rule_words
from procedures.tracker.procedure import check_payload
from procedures.tracker.stored import load_stored
from procedures.words import mm


def tracker_expectation(setup: Setup, job: TrackerSamplingConfig) -> dict[str, Any]:
    """``text`` and the figures of a plan from pose 'home' (or the middle of the ranges), and what was found.

    ``problems``: the job cannot succeed with these; ``cautions``: it can, but not as well as is asked.
    """
    if missing := setup.missing(job.arm, "tracker"):
        return {"text": missing[0], "problems": missing[:1], "cautions": []}
    if problem := _unknown(setup, job):
        return {"text": problem, "problems": [problem], "cautions": []}
    values, (noise, assumed) = setup.values, stated_noise(setup)
    try:
        check_payload(job, values)
        q = _start(setup, job, noise)
        entries = []
        if (name := job.with_set) is not None:
            entries = load_stored(name, job, robot_of(values, job), payload_of(job, values)).entries()
        request = PlanRequest(values, job.model_dump(), noise, job.T_base_tracker_nominal, q, stored=entries)
        plan = plan_sampling(request).listing
    except CellError as exc:
        fix = f" {exc.hint}" if isinstance(exc, AbortError) else ""
        return {"text": f"no plan: {exc}", "problems": [f"{exc}.{fix}"], "cautions": []}
    predicted, cautions = plan["predicted"], []
    if predicted["error_95_max_m"] > job.accept.max_error_m:
        cautions.append(
            f"accept.max_error_m is {mm(job.accept.max_error_m)}, and at the worst place 95 % of the errors "
            f"stay below {mm(predicted['error_95_max_m'], 3)} only; ask for more poses or raise it"
        )
    if not job.monuments:
        cautions.append("without monuments nothing says whether the tracker's stand moves; name some")
    return {
        "text": _words(job, plan, assumed),
        "poses": len(plan["poses"]),
        "predicted": predicted,
        "rank": plan["rank"],
        "unidentifiable": plan["unidentifiable"],
        "source_rule": plan["source_rule"],
        "by_rule": plan["by_rule"],
        "limits": [
            {
                "job": "tracker-sampling",
                "name": "predicted_95_m",
                "value": predicted["error_95_max_m"],
                "limit": job.accept.max_error_m,
            }
        ],
        "problems": [],
        "cautions": cautions,
    }


def _words(job: TrackerSamplingConfig, plan: dict[str, Any], assumed: str) -> str:
    predicted = plan["predicted"]
    sight = "" if job.T_base_tracker_nominal is not None else ", wherever the tracker stands"
    stored = f", {plan['stored']} of a stored set are solved with the others" if plan["stored"] else ""
    random = predicted["random_rms_m"]
    against = "" if random is None else f" ({mm(random, 4)} after as many random poses)"
    return (
        f"{len(plan['poses'])} of {job.poses} poses are reached and seen{sight}, {job.held_out} of them are "
        f"set aside{stored}; predictions elsewhere will be {mm(predicted['rms_m'], 4)} off (RMS){against}, "
        f"95 % of them less than {mm(predicted['error_95_max_m'], 4)} at the worst place, with {assumed}; "
        f"rank {plan['rank']} of {plan['rank_possible']} possible; the rule of thumb of 50 poses and "
        f"15 degrees {rule_words(plan)}"
    )


def _unknown(setup: Setup, job: TrackerSamplingConfig) -> str | None:
    """A sentence on reflectors that the tracker's section does not have; some drivers need none."""
    device = setup.roles["tracker"]
    known = getattr(setup.devices[device], "reflectors", None)
    missing = [name for name in (*job.reflectors, *job.monuments) if name not in (known or {})]
    if not known or not missing:
        return None
    return (
        f"[device.{device}] reflectors has {', '.join(known)}, but not '{missing[0]}', which "
        "[job.tracker-sampling] names; add it with its constant, or correct the name"
    )


def _start(setup: Setup, job: TrackerSamplingConfig, noise: dict[str, float]) -> list[float]:
    """Where the arm is taken to stand: at 'home', else in the middle of its ranges."""
    if job.arm == "arm" and "home" in setup.poses:
        return list(setup.poses["home"])
    middle: Array = make_space(setup.values, job, noise, None).ranges.mean(axis=1)
    return [float(v) for v in middle]
