"""What is to be warned of in a kinematic calibration, each with its code: data, fit, noise."""

from dataclasses import dataclass

import numpy as np

from calibration.identification.held_out import HeldOut, rms
from calibration.identification.label_swap import exchanged
from calibration.identification.noise import FLOOR, TYPICAL
from calibration.identification.observability import Observability, still_joints
from calibration.identification.range_offset import RangeOffset, range_offset
from calibration.identification.registration import register
from calibration.identification.solution import Solution
from procedures.tracker.solve.data import KincalSet

_MANY_REJECTED = 0.1
_FEW_LEFT = 1.0  # readings' numbers over unknowns, beyond one
_FAR_FROM_PRIOR = 5.0
_FAR_OFF = 0.03  # of the spread of the points
_NAMES_SHOWN = 6
_LARGE = 3.0  # times what laser trackers promise: more than gears and bending add
_SMALL = 0.1  # of the noise that is given: no mean of readings gains so much

Warnings = list[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class JudgedSolution:
    """A solution and how it was judged; ``classic`` when the classic method made it."""

    loaded: KincalSet
    solution: Solution
    observed: Observability
    judged: HeldOut
    classic: bool


def warnings_of(found: JudgedSolution) -> Warnings:
    """Codes and texts; none of a set that determines its arm as well as its noise allows."""
    return [
        *_of_samples(found),
        *_far_off(found.solution),
        *_rejected(found),
        *_of_noise(found),
        *_of_reflectors(found.solution),
        *_of_parameters(found),
    ]


def _of_samples(found: JudgedSolution) -> Warnings:
    solution, observed, judged = found.solution, found.observed, found.judged
    used, out = int(solution.used.sum()), []
    if observed.lacking:
        still = still_joints(solution.problem)
        cause = f" (joint {', '.join(str(j + 1) for j in still)} does not move)" if still else ""
        text = f"only the prior determines {'; '.join(observed.lacking)}{cause}"
        out.append(("observability.prior", text))
    if 3 * used < observed.unknowns * (1.0 + _FEW_LEFT):
        text = f"{used} samples give {3 * used} numbers for {observed.unknowns} unknowns; take more"
        out.append(("samples.few", text))
    if not len(judged.rows):
        out.append(
            ("heldout.none", "there are too few samples to hold any back; the accuracy is not checked")
        )
    elif not found.classic and (rms(judged.calibrated) or 0.0) > (rms(judged.registration) or 0.0):
        text = "on held-out samples the calibrated arm is no better than the nominal one in its best place"
        out.append(("calibration.no-gain", text))
    return out


def _far_off(solution: Solution) -> Warnings:
    """An arm that is farther from its nominal model than makers build them: most often the model is wrong."""
    problem, model = solution.problem.take(solution.used), solution.model
    if model.unknown_tools:
        return []
    nominal = model.points(model.nominal, problem.Q, problem.target)
    best = register(problem.p, nominal, np.ones(problem.n))
    off = rms(np.sqrt(np.sum((best.to_tracker(nominal) - problem.p) ** 2, axis=0))) or 0.0
    spread = rms(np.sqrt(np.sum((nominal - nominal.mean(axis=1, keepdims=True)) ** 2, axis=0))) or 0.0
    if off <= _FAR_OFF * spread:
        return []
    text = f"the nominal arm is {1e3 * off:.0f} mm off in its best place (RMS); check the robot and its tool"
    return [("robot.far-off", text)]


def _rejected(found: JudgedSolution) -> Warnings:
    """Copies have a warning of their own."""
    total = len(found.loaded.data.samples) - found.loaded.copies
    out = total - int(found.solution.used.sum())
    if out <= _MANY_REJECTED * total:
        return []
    return [("samples.rejected", f"{out} of {total} samples were not used")]


def _of_noise(found: JudgedSolution) -> Warnings:
    """Noise that is given against what the residuals show, or what they show against any tracker's."""
    solution = found.solution
    range_m = solution.problem.range_m[solution.used]
    sigma = solution.noise.sigma(range_m)
    if not solution.noise.given:
        promised = TYPICAL["sigma0"] + TYPICAL["sigma_per_m"] * range_m
        times = float(np.median(sigma / promised))
        if times <= _LARGE:
            return []
        return [("noise.large", _too_large_for_a_tracker(float(np.median(sigma)), times))]
    if solution.excess > 1.0:
        return [("noise.too-small", _too_small(solution))]
    left = 3.0 * len(sigma) - solution.unknowns
    squares = float(np.sum((solution.e[:, solution.used] / sigma) ** 2))
    if left > 0.0 and squares < _SMALL**2 * left:
        text = (
            f"the residuals are {np.sqrt(squares / left):.2g} of what the given noise explains; is it in "
            "metres? Uncertainties are as large as the noise that is given"
        )
        return [("noise.too-large", text)]
    return []


def _too_large_for_a_tracker(sigma: float, times: float) -> str:
    return (
        f"the readings scatter by {1e3 * sigma:.3g} mm along one axis about the calibrated arm, {times:.0f} "
        "times what laser trackers promise: the arm has errors that its parameters lack, as gears and "
        "bending, or samples or reflectors are mixed up, or it is another instrument (then give its noise)"
    )


def _too_small(solution: Solution) -> str:
    factor = float(np.sqrt(solution.excess))
    floor = " (it was raised to 1 um)" if solution.noise.sigma0 < FLOOR else ""
    return (
        f"the residuals are {factor:.1f} times what the given noise explains{floor}: the arm has errors that "
        "its parameters lack, as gears and bending, or the tracker is noisier, or a reflector's constant is "
        "wrong; the covariance is widened"
    )


def _of_reflectors(solution: Solution) -> Warnings:
    out = []
    offset = range_offset(solution)
    if offset is not None and offset.significant:
        out.append(("reflector.constant", _wrong_constant(offset)))
    if pairs := exchanged(solution.model, solution.x):
        told = ", ".join(f"{name} is where {other} should be" for name, other in pairs)
        out.append(("reflector.names", f"reflectors seem to have each other's names: {told}"))
    return out


def _wrong_constant(offset: RangeOffset) -> str:
    long = "long" if offset.offset_m > 0.0 else "short"
    names = _and_more(list(offset.targets))
    return (
        f"ranges to {names} look {1e3 * abs(offset.offset_m):.2f} mm too {long} (give "
        f"or take {2e3 * offset.sigma_m:.2f}): check the reflector's constant and kind; the error is in the "
        "arm that was found, and its uncertainty knows of no more than noise.sigma_constant says"
    )


def _of_parameters(found: JudgedSolution) -> Warnings:
    solution, loaded, out = found.solution, found.loaded, []
    geometric = [n for n, own in zip(solution.model.names, solution.model.geometric, strict=True) if own]
    added = [name for name in geometric if name not in loaded.model.names]
    if added:
        text = f"the residuals ask for {_and_more(added)}, which the robot's table leaves fixed; adjusted too"
        out.append(("numbers.added", text))
    if loaded.spec.robot.prior is not None:
        away = np.abs(solution.x - solution.model.nominal) / solution.model.sd
        far = (away > _FAR_FROM_PRIOR) & solution.model.geometric
        names = [solution.model.names[k] for k in np.flatnonzero(far)]
        if names:
            text = f"{_and_more(names)} moved more than {_FAR_FROM_PRIOR:.0f} times the robot's prior"
            out.append(("prior.far", text))
    return out


def _and_more(names: list[str]) -> str:
    shown = ", ".join(names[:_NAMES_SHOWN])
    return f"{shown} and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else shown
