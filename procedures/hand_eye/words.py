"""A hand-eye calibration in words: what was found, how sure it is, and what is expected of a plan."""

from collections.abc import Mapping, Sequence
from typing import Any

from cell.formats.result import Rejected
from procedures.hand_eye.budget import largest
from procedures.hand_eye.result import (
    AbsoluteAccuracy,
    AtTask,
    HandEyeAnswer,
    HandEyeHeldOut,
    HandEyeResiduals,
    HandEyeResult,
    HandEyeUncertainty,
    MovedCamera,
    TargetScale,
)
from procedures.hand_eye.result_spread import NeighbourBase, NeighbourSpread, Spread
from procedures.plan_words import plan_lines
from procedures.words import deg, listed, mm, pose_text, sigma_text

SETUPS = {
    "T_flange_camera": "camera in flange (eye-in-hand)",
    "T_base_camera": "camera in base (eye-to-hand)",
}
MOST_REJECTED_SHOWN = 10
FLOOR_UNKNOWN = (
    "what noise alone gives is not known: the noise of measured poses and the errors of the arm cannot be "
    "told apart"
)


def hand_eye_lines(found: HandEyeResult) -> list[str]:
    """The pose, its uncertainty, the residuals, and which observations were not used."""
    return [
        *_answer(found.result, found.uncertainty),
        *_moved(found.inputs.moved),
        *_residuals(found.residuals, found.heldout),
        *_rejected(found.result.rejected),
    ]


def _answer(answer: HandEyeAnswer, uncertainty: HandEyeUncertainty) -> list[str]:
    held = answer.pose()
    if held is None:
        return []
    name, pose = held
    lines = [f"  {SETUPS[name]}", f"  {name} = {pose_text(pose)}"]
    if answer.cov:
        lines.append(f"  standard uncertainty {sigma_text(answer.cov)}; it covers {_covered(uncertainty)}")
    if answer.budget:
        parts = [f"{part.block} {mm(part.t)}, {deg(part.r)}" for part in answer.budget]
        lines.append(f"  by cause: {'; '.join(parts)}")
    lines += [f"  {part} known by {source}" for part, source in (uncertainty.priors or {}).items()]
    if answer.target_scale:
        lines.append(f"  {_target_scale(answer.target_scale)}")
    if answer.absolute_accuracy:
        lines.append(f"  the arm's position error by the board is {_by_board(answer.absolute_accuracy)}")
    if answer.arm:
        now, then = answer.arm.configured, answer.arm.corrected
        lines.append(
            f"  the arm is {mm(now.t)}, {deg(now.r)} off its model (RMS over its joints; 95 % below "
            f"{mm(now.t95)}); {mm(then.t)}, {deg(then.r)} would be left with what was found taken off"
        )
    if answer.task:
        lines.append(f"  {_at_task(answer.task)}")
    spreads = spread_lines(answer)
    lines += [f"  {line}" for line in spreads]
    if spreads:
        lines.append("  (the two spreads tell how consistent the estimates are, not how accurate)")
    if answer.intrinsics:
        lines.append("  the camera's intrinsics were estimated from the images")
    return lines


def _at_task(task: AtTask) -> str:
    graded = f"; {mm(task.clearance_m)} is free: {task.grade}" if task.clearance_m is not None else ""
    return (
        f"at the task's place 95 % of the errors stay below {mm(task.configured95)} with the arm as "
        f"configured, below {mm(task.corrected95)} with the corrected one{graded}"
    )


def _moved(since: MovedCamera | None) -> list[str]:
    """Where the camera is against the version in effect."""
    if since is None:
        return []
    judged = "more than two such results differ by chance: look for a camera, a board or an arm that moved"
    told = judged if since.beyond_uncertainty else "as two such results may differ by chance"
    level = (
        "" if since.false_alarm is None else f" (chance alone is beyond in 1 of {1 / since.false_alarm:.4g})"
    )
    return [f"  {mm(since.t)}, {deg(since.r)} from version {since.version}, {told}{level}"]


def _target_scale(scale: TargetScale) -> str:
    sizes = (("x", scale.x, scale.sigma_x), ("y", scale.y, scale.sigma_y))
    found = ", ".join(f"{100 * v:+.3f} % +- {100 * s:.3f} % along {axis}" for axis, v, s in sizes)
    return f"the target's printed size: {found} (standard uncertainty)"


def _covered(uncertainty: HandEyeUncertainty) -> str:
    """What the uncertainty covers and what it takes as exact."""
    if not uncertainty.covers:
        return "noise alone: arm, lens and target are taken as exact"
    if "arm" not in uncertainty.covers:
        return f"noise, {' and '.join(uncertainty.covers)}: the arm is taken as exact"
    return f"noise, {', '.join(uncertainty.covers)}"


def spread_lines(answer: HandEyeAnswer) -> list[str]:
    """The two consistency figures, each with the floor that noise alone gives."""
    both = (("within", answer.spread_within), ("across", answer.spread_across))
    first = answer.as_configured
    before = {} if first is None else {"within": first.spread_within, "across": first.spread_across}
    return [
        f"spread {where} placements {_spread_text(spread, before.get(where))}"
        for where, spread in both
        if spread
    ] + _unweighted(answer.neighbour_spread)


def _unweighted(classic: NeighbourSpread | None) -> list[str]:
    """The same figures by the classic cone method, which published ones may be held against."""
    if classic is None:
        return []
    told = _plain_spreads(classic)
    if classic.not_determined:
        told.append(f"not determined: {classic.not_determined}")
    order = "the cone's order" if classic.order == "planned" else "the order in which they were taken"
    lines = [f"unweighted, from neighbours in {order}: spread {'; '.join(told)}"] if told else []
    lines += [
        f"unweighted, base {int(base) + 1}: {'; '.join(spreads)}"
        for base, part in classic.by_base.items()
        if told and (spreads := _plain_spreads(part))
    ]
    return lines + ([f"the unweighted spreads are {classic.verdict}"] if classic.verdict else [])


def _plain_spreads(of: NeighbourSpread | NeighbourBase) -> list[str]:
    both = (("within", of.within), ("across", of.across))
    return [f"{where} placements {mm(one.t_norm)}, {deg(one.r)}" for where, one in both if one is not None]


def _spread_text(spread: Spread, configured: Spread | None) -> str:
    text = f"{mm(spread.t_norm)}, {deg(spread.r)}"
    if configured is not None:
        text += f", as configured {mm(configured.t_norm)}, {deg(configured.r)}"
    if not spread.floor_known:
        return f"{text} ({FLOOR_UNKNOWN})"
    text += f" (noise alone gives {mm(spread.floor_t)}, {deg(spread.floor_r)}"
    return text + (")" if spread.resolved else ": not resolved)")


def _residuals(residuals: HandEyeResiduals, held: HandEyeHeldOut) -> list[str]:
    spread, held_out = residuals.spread_mean, residuals.loo_mean
    lines = [f"  mean distance of the target's poses from their mean {mm(spread.t)}, {deg(spread.r)}"]
    if held_out.t is not None:  # leaving one out may leave too few
        colon = ":" if held.from_all else ""
        lines.append(f"  each judged {by_others(held)}{colon} {mm(held_out.t)}, {deg(held_out.r)}")
    if held.rejected and (off := held.rms_with_rejected) is not None and off.t is not None:
        lines.append(
            f"  held out RMS with the {held.rejected} that were left out counted as well "
            f"{mm(off.t)}, {deg(off.r)}"
        )
    if (off := held.rms_by_placement) is not None and off.t is not None:
        lines.append(f"  each placement judged by the others {mm(off.t)}, {deg(off.r)} RMS")
    if (pixels := residuals.reprojection_rms_px) is not None:
        lines.append(f"  reprojection {pixels:.3f} px RMS (residuals are not accuracy)")
    return lines


def by_others(held: HandEyeHeldOut) -> str:
    """What judges a pose that was left out, and what of it was found from that pose too."""
    if not held.from_all:
        return "by a solution that did not see it"
    return f"by a camera's pose from the others, with {listed(held.from_all)} as found from all"


def _rejected(rejected: Sequence[Rejected]) -> list[str]:
    if not rejected:
        return []
    lines = [f"  {len(rejected)} observations were not used:"]
    lines += [f"    {r.index}: {r.reason}" for r in rejected[:MOST_REJECTED_SHOWN]]
    if len(rejected) > MOST_REJECTED_SHOWN:
        lines.append(f"    and {len(rejected) - MOST_REJECTED_SHOWN} more; --json lists them all")
    return lines


def _by_board(found: AbsoluteAccuracy) -> str:
    """What is expected to be left may be more than was found: that a correction helps is then not shown."""
    left, below = mm(found.after), f"95 % below {mm(found.predicted_95)}"
    if found.after >= found.before:
        return (
            f"{mm(found.before)} RMS, not more than the {left} to which it is known ({below}): these data "
            "do not show that the corrected arm is better"
        )
    return f"{mm(found.before)} RMS, {left} with the corrected arm in result.robot ({below})"


def so_far_text(error: Mapping[str, Any]) -> str:
    """What is known after the placements that are finished."""
    text = f"{mm(error['error95_t_m'])} and {deg(error['error95_r_rad'])} (95 %)"
    if not error["budget"]:
        return f"so far the camera's pose is known to {text}"
    most = largest(error["budget"], "t")
    return f"so far the camera's pose is known to {text}, limited most by {most}"


# What lowers the share of a cause that no number of poses lowers.
MEASURES = {
    "lens": "calibrate the camera and state camera_sigma",
    "target": "measure the target over ten squares and state its scale_sigma and flatness_m",
    "arm": "capture with more different joints",
    "noise": "plan more poses",
}


def prediction_text(predicted: Mapping[str, Any]) -> str:
    """The expected error of the calibration, what causes it, and what was assumed for it."""
    assumed, limit = predicted["assuming"], predicted["limit"]
    causes = ", ".join(f"{p['block']} {mm(p['t'])} {deg(p['r'])}" for p in predicted["budget"])
    known = "; ".join(f"{part}: {source}" for part, source in predicted["priors"].items())
    return (
        f"expected error below {mm(predicted['error95_t_m'])} and {deg(predicted['error95_r_rad'])} (95 %), "
        f"of which by cause (standard uncertainty) {causes}; "
        f"known then (standard uncertainty): {_known_text(predicted['known'])}; {_limit_text(limit)}; "
        f"assuming {assumed['placements']} placements like this one, corners to {assumed['sigma_px']:g} px, "
        f"flange poses to {mm(assumed['sigma_flange_t'])} and {deg(assumed['sigma_flange_r'])}; {known}"
    )


def _limit_text(limit: Mapping[str, Any]) -> str:
    """What no number of poses tells, and what would."""
    causes = dict.fromkeys([limit["block_t"], limit["block_r"]])
    return (
        f"any number of placements like this one leaves {mm(limit['error95_t_m'])}, most of it by "
        f"{limit['block_t']}, and {deg(limit['error95_r_rad'])}, most of it by {limit['block_r']}, with "
        f"{_known_text(limit['known'])}; to lower that, {', and '.join(MEASURES[cause] for cause in causes)}"
    )


def _known_text(known: Mapping[str, float]) -> str:
    """How well the parts are known."""
    parts = [
        f"focal length {100 * known['focal']:.3f} %",
        f"principal point {known['centre_px']:.2f} px",
        f"printed size {100 * known['scale']:.3f} %",
        f"flatness {mm(known['bow_m'])}",
    ]
    if "arm_m" in known:
        parts.append(f"places of the arm over its joints {mm(known['arm_m'])}")
    return ", ".join(parts)


def cone_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """The poses of a cone, and what is expected of them."""
    predicted = plan.get("predicted")
    return plan_lines(plan) + ([prediction_text(predicted)] if predicted else [])
