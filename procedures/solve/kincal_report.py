"""The result of a kinematic calibration: every figure with its name, in the form of FORMATS section 4."""

from dataclasses import dataclass

import numpy as np

from calibration.identification.classic import Classic, solve_classic
from calibration.identification.estimator import Problem
from calibration.identification.held_out import FOLDS, HeldOut, held_out, rms
from calibration.identification.model import REGISTRATION
from calibration.identification.noise import FLOOR
from calibration.identification.observability import Observability, still_joints
from calibration.identification.range_offset import RangeOffset, range_offset
from calibration.identification.registration import Registration, register
from calibration.identification.selection import source_rule
from calibration.identification.solution import Solution
from calibration.identification.workspace import forecast, places
from calibration.kinematics.families import robot_document
from cell.formats.result import Result, Warning_
from cell.poses import Array, to_pose6
from procedures.solve.kincal_data import KincalSet
from procedures.solve.kincal_queries import Query, Wanted, answer_query, answer_targets

_MANY_REJECTED = 0.1
_FEW_LEFT = 1.0  # readings' numbers over unknowns, beyond one
_FAR_FROM_PRIOR = 5.0
_FAR_OFF = 0.03  # of the spread of the points
_NAMES_SHOWN = 6


@dataclass(frozen=True)
class Solved:
    """Everything that the result is written from."""

    loaded: KincalSet
    solution: Solution
    observed: Observability
    classic: Classic | None
    query: Query | None
    wanted: Wanted | None
    inputs: dict[str, object]


def fill_result(solved: Solved) -> Result:
    """The whole result; the verdict is ``warn`` when anything is to be warned of."""
    solution = solved.solution
    judged = held_out(solution, None if solved.classic is None else _refit_classic)
    answer, warnings = _answer(solved, judged)
    warnings = [*solved.loaded.warnings, *_warnings(solved, judged), *warnings]
    return Result(
        kind="kincal",
        verdict="warn" if warnings else "pass",
        reasons=[text for _, text in warnings],
        warnings=[Warning_(code=c, text=t) for c, t in warnings],
        result=answer,
        uncertainty=_uncertainty(solution),
        residuals=_residuals(solved, judged),
        heldout=_held_out(solution, judged),
        observability=_observability(solved),
        inputs={**solved.inputs, "used": int(solution.used.sum())},
    )


def _refit_classic(part: Problem, _start: Array, _weight: Array) -> tuple[Array, Registration]:
    found = solve_classic(part)
    return found.x, found.registration


def _answer(solved: Solved, judged: HeldOut) -> tuple[dict[str, object], list[tuple[str, str]]]:
    solution, observed, spec = solved.solution, solved.observed, solved.loaded.spec
    model, x = solution.model, solution.x
    own = len(model.arm.names)
    tools = {**spec.tools, **dict(zip(model.targets, model.tools(x), strict=True))}
    sigma = None if solution.cov is None else np.sqrt(np.diag(solution.cov)[: model.size])
    answer: dict[str, object] = {
        "parameters": _named(model.names, x),
        "nominal": _named(model.names, model.nominal),
        "sigma": None
        if sigma is None
        else {
            name: None if open_ else float(s)
            for name, s, open_ in zip(model.names, sigma, observed.open, strict=True)
        },
        "rank": observed.rank,
        "rank_without_registration": observed.rank_alone,
        "unidentifiable": list(observed.unidentifiable),
        "T_tracker_base": [float(v) for v in to_pose6(solution.T_tracker_base)],
        "direction": "base in tracker",
        "rms_nominal": rms(judged.nominal),
        "rms_registration_only": rms(judged.registration),
        "rms_calibrated": rms(judged.calibrated),
        "robot": robot_document(spec, model.arm, x[:own], tools),
        "noise": {
            "sigma0": solution.noise.sigma0,
            "sigma_per_m": solution.noise.sigma_per_m,
            "given": solution.noise.given,
            "excess": solution.excess,
        },
        "rejected": _rejected(solved),
        "payload_kg": solved.loaded.data.payload_kg,
    }
    if solved.classic is not None:
        answer["classic"] = {"iterations": solved.classic.iterations, "stopped": solved.classic.stopped}
    if solved.query is not None:
        answer |= answer_query(solution, solved.query)
    if solved.wanted is None:
        return answer, []
    found, warnings = answer_targets(solution, solved.wanted)
    return answer | found, warnings


def _named(names: tuple[str, ...], values: Array) -> dict[str, float]:
    return {name: float(v) for name, v in zip(names, values, strict=True)}


def _rejected(solved: Solved) -> list[dict[str, object]]:
    loaded = solved.loaded
    reasons = dict(loaded.unusable)
    reasons |= {loaded.rows[k]: text for k, text in solved.solution.reasons.items()}
    return [{"index": loaded.indices[k], "reason": reasons[k]} for k in sorted(reasons)]


def _uncertainty(solution: Solution) -> dict[str, object]:
    if solution.cov is None:
        return {"cov": None, "meaning": "this method gives no uncertainty"}
    registration = [f"{kind}_{axis}" for kind in ("turn", "shift") for axis in "xyz"]
    at = forecast(solution, solution.problem.Q[solution.used])
    elsewhere = forecast(solution, places(solution.problem.Q))
    worst = int(np.argmax(elsewhere.error95))
    return {
        "names": [*solution.model.names, *registration],
        "cov": solution.cov.tolist(),
        "cov_meaning": "parameters, then a turn (rad) and a shift (m) of the tracker's points in the base; "
        "open combinations are as uncertain as the prior, and cancel in predictions",
        "predicted_95": {
            "samples": {"median": float(np.median(at.error95)), "max": float(at.error95.max())},
            "workspace": {
                "median": float(np.median(elsewhere.error95)),
                "max": float(elsewhere.error95.max()),
                "worst_q": elsewhere.q[worst].tolist(),
                "places": [
                    {"q": q.tolist(), "p_base": p.tolist(), "error_95": float(e)}
                    for q, p, e in zip(elsewhere.q, elsewhere.p, elsewhere.error95, strict=True)
                ],
            },
            "meaning": "95 % of prediction errors in the tracker frame stay below this (m), at the samples "
            "and at joints spread over the ranges of the samples, if the model holds",
        },
        "tracker": _tracker(solution),
    }


def _tracker(solution: Solution) -> dict[str, float]:
    """The tracker's own uncertainty at the middle range, along one axis and as a 3D distance."""
    middle = float(np.median(solution.problem.range_m))
    sigma = float(solution.noise.sigma(np.array([middle]))[0])
    return {"range_m": middle, "sigma_axis": sigma, "sigma_3d": float(np.sqrt(3.0) * sigma)}


def _residuals(solved: Solved, judged: HeldOut) -> dict[str, object]:
    solution, loaded = solved.solution, solved.loaded
    problem, model, used = solution.problem, solution.model, solution.used
    off = np.sqrt(np.sum(solution.e**2, axis=0))
    drawn = model.points(model.nominal, problem.Q, problem.target)
    own = np.sqrt(np.sum((solution.registration.to_tracker(drawn) - problem.p) ** 2, axis=0))
    best = register(problem.p[:, used], drawn[:, used], np.ones(int(used.sum())))
    registered = np.sqrt(np.sum((best.to_tracker(drawn) - problem.p) ** 2, axis=0))
    unseen = dict(zip(judged.rows.tolist(), judged.calibrated.tolist(), strict=True))
    index = loaded.indices
    return {
        "rms": rms(off[used]),
        "max": float(off[used].max()),
        "rms_nominal": rms(own[used]),
        "rms_registration_only": rms(registered[used]),
        "per_sample": [
            {
                "index": index[loaded.rows[k]],
                "target": model.targets[int(problem.target[k])],
                "used": bool(used[k]),
                "e_base": solution.e[:, k].tolist(),
                "distance": float(off[k]),
                "nominal": float(registered[k]),
                "heldout": unseen.get(k),
                "range_m": float(problem.range_m[k]),
                "of_chance": float(solution.distance[k]),
            }
            for k in range(problem.n)
        ],
    }


def _held_out(solution: Solution, judged: HeldOut) -> dict[str, object]:
    figures = (judged.nominal, judged.registration, judged.calibrated)
    names = ("nominal", "registration_only", "calibrated")
    return {
        "folds": FOLDS,
        "samples": len(judged.rows),
        "rms": {name: rms(d) for name, d in zip(names, figures, strict=True)},
        "max": {name: float(d.max()) if len(d) else None for name, d in zip(names, figures, strict=True)},
        "tracker_3d": _tracker(solution)["sigma_3d"],
        "meaning": "distance (m) of tracker readings from their prediction by an arm that did not see them; "
        "the tracker's own noise is in it. nominal: the drawing, in the place of the tracker that the "
        "calibrated arm found; registration_only: the drawing, in the place that suits it best",
    }


def _observability(solved: Solved) -> dict[str, object]:
    observed, problem = solved.observed, solved.solution.problem
    rule = source_rule(problem.Q * np.max(np.abs(problem.model.arm.base.coupling), axis=0))
    return {
        "parameters": problem.model.size,
        "rank": observed.rank,
        "rank_without_registration": observed.rank_alone,
        "rank_possible": observed.rank_possible,
        "unknowns_with_registration": observed.rank + REGISTRATION,
        "condition": observed.condition,
        "unidentifiable": list(observed.unidentifiable),
        "unobservable": list(observed.lacking),
        "joint_range": [float(v) for v in np.ptp(problem.Q, axis=0)],
        "source_rule": {
            "kept": rule.kept,
            "samples": rule.poses,
            "short_steps": rule.short_steps,
            "smallest_step_rad": rule.smallest_rad if np.isfinite(rule.smallest_rad) else None,
            "meaning": "the source asks for 50 poses, every joint more than 15 deg from one to the next",
        },
    }


def _warnings(solved: Solved, judged: HeldOut) -> list[tuple[str, str]]:
    solution, observed, loaded = solved.solution, solved.observed, solved.loaded
    problem, used = solution.problem, int(solution.used.sum())
    out: list[tuple[str, str]] = []
    if observed.lacking:
        still = still_joints(problem)
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
    elif solved.classic is None and (rms(judged.calibrated) or 0.0) > (rms(judged.registration) or 0.0):
        text = "on held-out samples the calibrated arm is no better than the nominal one in its best place"
        out.append(("calibration.no-gain", text))
    out += _far_off(solution)
    total = len(loaded.data.samples)
    if total - used > _MANY_REJECTED * total:
        out.append(("samples.rejected", f"{total - used} of {total} samples were not used"))
    if solution.excess > 1.0 and solved.classic is None:
        out.append(("noise.too-small", _too_small(solution)))
    offset = range_offset(solution)
    if offset is not None and offset.significant:
        out.append(("reflector.constant", _wrong_constant(offset)))
    added = [name for name in solution.model.names if name not in loaded.model.names]
    if added:
        text = f"the residuals ask for {_and_more(added)}, which the robot's table leaves fixed; adjusted too"
        out.append(("numbers.added", text))
    if loaded.spec.robot.prior is not None:
        away = np.abs(solution.x - solution.model.nominal) / solution.model.sd
        names = [solution.model.names[k] for k in np.flatnonzero(away > _FAR_FROM_PRIOR)]
        if names:
            text = f"{_and_more(names)} moved more than {_FAR_FROM_PRIOR:.0f} times the robot's prior"
            out.append(("prior.far", text))
    return out


def _far_off(solution: Solution) -> list[tuple[str, str]]:
    """An arm that is farther from its drawing than workshops build them: most often the drawing is wrong."""
    problem, model = solution.problem.take(solution.used), solution.model
    if model.unknown_tools:
        return []
    drawn = model.points(model.nominal, problem.Q, problem.target)
    best = register(problem.p, drawn, np.ones(problem.n))
    off = rms(np.sqrt(np.sum((best.to_tracker(drawn) - problem.p) ** 2, axis=0))) or 0.0
    spread = rms(np.sqrt(np.sum((drawn - drawn.mean(axis=1, keepdims=True)) ** 2, axis=0))) or 0.0
    if off <= _FAR_OFF * spread:
        return []
    text = f"the nominal arm is {1e3 * off:.0f} mm off in its best place (RMS); check the robot and its tool"
    return [("robot.far-off", text)]


def _too_small(solution: Solution) -> str:
    factor = float(np.sqrt(solution.excess))
    floor = " (it was raised to 1 um)" if solution.noise.sigma0 < FLOOR else ""
    return (
        f"the residuals are {factor:.1f} times what the given noise explains{floor}: the arm has errors that "
        "its parameters lack, as gears and bending, or the tracker is noisier, or a reflector's constant is "
        "wrong; the covariance is widened"
    )


def _wrong_constant(offset: RangeOffset) -> str:
    long = "long" if offset.offset_m > 0.0 else "short"
    names = _and_more(list(offset.targets))
    return (
        f"ranges to {names} look {1e3 * abs(offset.offset_m):.2f} mm too {long} (give "
        f"or take {2e3 * offset.sigma_m:.2f}): check the reflector's constant and kind; the error is in the "
        "arm that was found, and its uncertainty does not know of it"
    )


def _and_more(names: list[str]) -> str:
    shown = ", ".join(names[:_NAMES_SHOWN])
    return f"{shown} and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else shown
