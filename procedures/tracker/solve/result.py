"""The result of a kinematic calibration: every figure with its name, in the form of docs/data-sets.md."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.identification.classic import Classic, solve_classic
from calibration.identification.estimator import Problem
from calibration.identification.held_out import HeldOut, by_region, held_out, rms
from calibration.identification.joint_errors import can_tell
from calibration.identification.model import REGISTRATION
from calibration.identification.observability import Observability
from calibration.identification.reflector_constant import KEY, constant_of, moved, unnoticed
from calibration.identification.registration import Registration, register
from calibration.identification.selection import source_rule
from calibration.identification.solution import Solution
from calibration.identification.workspace import forecast, places
from calibration.kinematics.families import robot_document
from cell.formats.result import Rejected, Warning_
from cell.poses import Array, to_pose6
from procedures.tracker.result import (
    JointErrorSizes,
    KincalAnswer,
    KincalHeldOut,
    KincalInputs,
    KincalObservability,
    KincalResiduals,
    KincalResult,
    KincalUncertainty,
    NoiseInUse,
    Off,
    PlaceError,
    Predicted95,
    ReflectorConstant,
    SampleResidual,
    SourceRule,
    Spread95,
    TrackerNoise,
    Workspace95,
)
from procedures.tracker.solve.data import KincalSet
from procedures.tracker.solve.queries import Query, Wanted, answer_query, answer_targets
from procedures.tracker.solve.warnings import JudgedSolution, warnings_of


@dataclass(frozen=True)
class Solved:
    """Everything that the result is written from."""

    loaded: KincalSet
    solution: Solution
    observed: Observability
    classic: Classic | None
    query: Query | None
    wanted: Wanted | None
    inputs: dict[str, Any]


def fill_result(solved: Solved) -> KincalResult:
    """The whole result; the verdict is ``warn`` when anything is to be warned of."""
    solution = solved.solution
    refit = None if solved.classic is None else _refit_classic
    judged = held_out(solution, refit)
    answer, warnings = _answer(solved, judged)
    warnings = [*solved.loaded.warnings, *_findings(solved, judged), *warnings]
    return KincalResult(
        verdict="warn" if warnings else "pass",
        reasons=[text for _, text in warnings],
        warnings=Warning_.each(warnings),
        result=KincalAnswer.model_validate(answer),
        uncertainty=_uncertainty(solution),
        residuals=_residuals(solved, judged),
        heldout=_held_out(solution, judged, by_region(solution, refit)),
        observability=_observability(solved),
        inputs=KincalInputs(**solved.inputs, used=int(solution.used.sum())),
    )


def _refit_classic(part: Problem, _start: Array, _weight: Array) -> tuple[Array, Registration]:
    found = solve_classic(part)
    return found.x, found.registration


def _answer(solved: Solved, judged: HeldOut) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    solution, observed, spec = solved.solution, solved.observed, solved.loaded.spec
    model, x = solution.model, solution.x
    own = len(model.arm.names)
    tools = {**spec.tools, **dict(zip(model.targets, model.tools(x), strict=True))}
    sigma = None if solution.cov is None else np.sqrt(np.diag(solution.cov)[: model.size])
    answer: dict[str, Any] = {
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
        "rms_calibrated_all": _rms_of_all(solution, judged),
        "robot": robot_document(spec, model.arm, x[:own], tools),
        "noise": NoiseInUse(
            sigma0=solution.noise.sigma0,
            sigma_per_m=solution.noise.sigma_per_m,
            given=solution.noise.given,
            excess=solution.excess,
            sigma_constant=solved.loaded.noise.get(KEY),
        ),
        "joint_errors": _joint_errors(solved),
        "reflector_constant_m": solution.constant_m,
        "rejected": _rejected(solved),
        "payload_kg": solved.loaded.data.payload_kg,
    }
    if solved.classic is not None:
        answer["classic"] = {"iterations": solved.classic.iterations, "stopped": solved.classic.stopped}
    warnings: list[tuple[str, str]] = []
    if solved.query is not None:
        found, told = answer_query(solution, solved.query)
        answer, warnings = answer | found, warnings + told
    if solved.wanted is not None:
        found, told = answer_targets(solution, solved.wanted)
        answer, warnings = answer | found, warnings + told
    return answer, warnings


def _joint_errors(solved: Solved) -> JointErrorSizes | None:
    """How large the errors of gears and sag are, null where none are seen; None where they were not looked
    for, or too few readings tell."""
    solution = solved.solution
    model, found = solution.model, dict[str, float | None]()
    looked = solved.inputs["method"] == "adjustment"
    if not looked or not can_tell(solution.problem, solution.used, solution.unknowns):
        return None
    for kind in model.error_sd:
        rows = [k for k, n in enumerate(model.names) if n.startswith(kind) and not model.geometric[k]]
        found[f"{kind}_rad"] = rms(solution.x[rows])
    meaning = (
        "RMS of the amplitudes: of gears once and twice a turn of a joint, of the joints that give way under "
        "the weight of the arm"
    )
    return JointErrorSizes(gear_rad=found["gear_rad"], sag_rad=found["sag_rad"], meaning=meaning)


def _named(names: tuple[str, ...], values: Array) -> dict[str, float]:
    return {name: float(v) for name, v in zip(names, values, strict=True)}


def _rejected(solved: Solved) -> list[Rejected]:
    loaded = solved.loaded
    reasons = dict(loaded.unusable)
    reasons |= {loaded.rows[k]: text for k, text in solved.solution.reasons.items()}
    return [Rejected(index=loaded.indices[k], reason=reasons[k]) for k in sorted(reasons)]


def _uncertainty(solution: Solution) -> KincalUncertainty:
    if solution.cov is None:
        meaning = "this method gives no uncertainty"
        return KincalUncertainty(cov=None, meaning=meaning, tracker=_tracker(solution))
    registration = [f"{kind}_{axis}" for kind in ("turn", "shift") for axis in "xyz"]
    at = forecast(solution, solution.problem.Q[solution.used])
    elsewhere = forecast(solution, places(solution.problem.Q))
    worst = int(np.argmax(elsewhere.error95))
    return KincalUncertainty(
        names=[*solution.model.names, *registration],
        cov=solution.cov.tolist(),
        cov_meaning="parameters, then a turn (rad) and a shift (m) of the tracker's points in the base; "
        "open combinations are as uncertain as the prior, and cancel in predictions",
        predicted_95=Predicted95(
            samples=Spread95(median=float(np.median(at.error95)), max=float(at.error95.max())),
            workspace=Workspace95(
                median=float(np.median(elsewhere.error95)),
                max=float(elsewhere.error95.max()),
                worst_q=elsewhere.q[worst].tolist(),
                places=[
                    PlaceError(q=q.tolist(), p_base=p.tolist(), error_95=float(e))
                    for q, p, e in zip(elsewhere.q, elsewhere.p, elsewhere.error95, strict=True)
                ],
            ),
            meaning="95 % of prediction errors in the tracker frame stay below this (m), at the samples "
            "and at joints spread over the ranges of the samples; errors of gears and sag are in "
            "it as far as the readings show them, backlash and warmth are not",
        ),
        degrees_of_freedom=None if np.isinf(solution.freedom) else solution.freedom,
        tracker=_tracker(solution),
        reflector_constant=_constant(solution),
    )


def _constant(solution: Solution) -> ReflectorConstant | None:
    """What is open of the reflector's constant, and what a wrong one may do that nobody notices."""
    told = constant_of(solution)
    if told is None:
        return None
    Q = places(solution.problem.Q)
    _, J = solution.model.linearised(solution.x, Q, np.zeros(len(Q), dtype=np.int64))
    hidden = unnoticed(told)
    return ReflectorConstant(
        sigma=solution.constant_sigma_m,
        readings_sigma=told.sigma_m,
        unnoticed=hidden,
        unnoticed_error_max=float(hidden * moved(told, J).max()),
        meaning="sigma: what is left open of the constant (m, along the beam), in the covariance; 0 where "
        "the data set's noise has no sigma_constant, for then the constant is taken as right. "
        "readings_sigma: what these readings alone would leave open. A wrong constant below unnoticed may "
        "not show, and moves places in the tracker frame by up to unnoticed_error_max",
    )


def _tracker(solution: Solution) -> TrackerNoise:
    """The noise of a reading at the middle range, along one axis and as a 3D distance.

    As it was given for the tracker; where none was, what the residuals show, which is never less.
    """
    middle = float(np.median(solution.problem.range_m))
    sigma = float(solution.noise.sigma(np.array([middle]))[0])
    return TrackerNoise(range_m=middle, sigma_axis=sigma, sigma_3d=float(np.sqrt(3.0) * sigma))


def _residuals(solved: Solved, judged: HeldOut) -> KincalResiduals:
    solution, loaded = solved.solution, solved.loaded
    problem, model, used = solution.problem, solution.model, solution.used
    off = np.sqrt(np.sum(solution.e**2, axis=0))
    nominal = model.points(model.nominal, problem.Q, problem.target)
    own = np.sqrt(np.sum((solution.registration.to_tracker(nominal) - problem.p) ** 2, axis=0))
    best = register(problem.p[:, used], nominal[:, used], np.ones(int(used.sum())))
    registered = np.sqrt(np.sum((best.to_tracker(nominal) - problem.p) ** 2, axis=0))
    unseen = dict(zip(judged.rows.tolist(), judged.calibrated.tolist(), strict=True))
    index = loaded.indices
    return KincalResiduals(
        rms=_rms(off[used]),
        max=float(off[used].max()),
        rms_nominal=_rms(own[used]),
        rms_registration_only=_rms(registered[used]),
        per_sample=[
            SampleResidual(
                index=index[loaded.rows[k]],
                target=model.targets[int(problem.target[k])],
                used=bool(used[k]),
                e_base=solution.e[:, k].tolist(),
                distance=float(off[k]),
                nominal=float(registered[k]),
                heldout=unseen.get(k),
                range_m=float(problem.range_m[k]),
                of_chance=float(solution.distance[k]),
            )
            for k in range(problem.n)
        ],
    )


def _rms(distance: Array) -> float:
    return float(np.sqrt(np.mean(distance**2)))


def _rms_of_all(solution: Solution, judged: HeldOut) -> float | None:
    """With the readings that were left out: no solution saw these."""
    rejected = np.linalg.norm(solution.e[:, ~solution.used], axis=0)
    return rms(np.concatenate([judged.calibrated, rejected]))


def _held_out(solution: Solution, judged: HeldOut, regions: HeldOut) -> KincalHeldOut:
    figures = (judged.nominal, judged.registration, judged.calibrated)
    names = ("nominal", "registration_only", "calibrated")
    return KincalHeldOut(
        folds=judged.folds,
        samples=len(judged.rows),
        rms=Off(**{name: rms(d) for name, d in zip(names, figures, strict=True)}),
        max=Off(**{name: float(d.max()) if len(d) else None for name, d in zip(names, figures, strict=True)}),
        rejected=int(np.count_nonzero(~solution.used)),
        rms_with_rejected=_rms_of_all(solution, judged),
        rms_by_region=rms(regions.calibrated),
        tracker_3d=_tracker(solution).sigma_3d,
        meaning="distance (m) of tracker readings from their prediction by an arm that did not see them; "
        "the tracker's own noise is in it. nominal: the nominal arm, in the place of the tracker that the "
        "calibrated arm found; registration_only: the nominal arm, in the place that suits it best",
    )


def _observability(solved: Solved) -> KincalObservability:
    observed, problem = solved.observed, solved.solution.problem
    rule = source_rule(problem.Q * np.max(np.abs(problem.model.arm.base.coupling), axis=0))
    return KincalObservability(
        parameters=problem.model.size,
        rank=observed.rank,
        rank_without_registration=observed.rank_alone,
        rank_possible=observed.rank_possible,
        unknowns_with_registration=observed.rank + REGISTRATION,
        condition=observed.condition,
        unidentifiable=list(observed.unidentifiable),
        unobservable=list(observed.lacking),
        joint_range=[float(v) for v in np.ptp(problem.Q, axis=0)],
        source_rule=SourceRule(
            kept=rule.kept,
            samples=rule.poses,
            short_steps=rule.short_steps,
            smallest_step_rad=rule.smallest_rad if np.isfinite(rule.smallest_rad) else None,
            meaning="a rule of thumb asks for 50 poses, every joint more than 15 deg from one to the next",
        ),
    )


def _findings(solved: Solved, judged: HeldOut) -> list[tuple[str, str]]:
    return warnings_of(
        JudgedSolution(
            loaded=solved.loaded,
            solution=solved.solution,
            observed=solved.observed,
            judged=judged,
            classic=solved.classic is not None,
        )
    )
