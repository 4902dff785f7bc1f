"""Kinematic calibration from tracker points: the one path of jobs, replay and ``cellward solve``."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calibration.identification.classic import Classic, solve_classic
from calibration.identification.estimator import Problem
from calibration.identification.model import REGISTRATION
from calibration.identification.noise import estimated, first_noise
from calibration.identification.observability import Observability, observe, refuse
from calibration.identification.reflector_constant import identify_with_constant
from calibration.identification.solution import Solution
from calibration.refusal import Refusal
from cell.errors import error
from cell.formats.result import Result
from cell.poses import Array
from procedures.solving import Progress, refused, within_limits
from procedures.timed import timed
from procedures.tracker.result import KincalResult
from procedures.tracker.solve.data import KincalSet, check_match, load_kincal
from procedures.tracker.solve.queries import Query, Wanted, load_query, load_targets
from procedures.tracker.solve.result import Solved, fill_result

ADJUSTMENT, ML, CLASSIC = "adjustment", "ml", "classic"


@within_limits
def solve_kincal(
    path: Path,
    *,
    method: str | None = None,
    predict: Path | None = None,
    targets: Path | None = None,
    robot: Path | None = None,
    progress: Progress | None = None,
    calls: int = 1,
) -> KincalResult | Result:
    """The result of tracker points: a folder with kincal.json, JSON, CSV or MATLAB.

    ``method`` is ``adjustment`` (weighted maximum likelihood by variable projection of geometry, gears and
    sag, the default), ``ml`` (of the geometry alone) or ``classic``.
    ``predict`` is a file with joints whose readings are wanted, ``targets`` one with wanted poses,
    ``robot`` one with the ROBOT. ``calls``: how often it is solved, for those who compare its
    time. Bad input raises an ``InputError``; data that cannot determine the arm give a result with verdict
    ``fail``.
    """
    chosen = method or ADJUSTMENT
    if chosen not in (ADJUSTMENT, ML, CLASSIC):
        known = f"{ADJUSTMENT}, {ML}, {CLASSIC}"
        raise error("ARGUMENT_INVALID", f"method is {method!r}; it must be one of {known}")
    loaded = load_kincal(Path(path), None if robot is None else Path(robot))
    query = None if predict is None else load_query(Path(predict), loaded)
    wanted = None if targets is None else load_targets(Path(targets), loaded)
    if progress is not None:
        progress("solve", 0, 1)
    result = _solve(loaded, chosen, query, wanted, calls)
    if progress is not None:
        progress("solve", 1, 1)
    return result


def _solve(
    loaded: KincalSet, method: str, query: Query | None, wanted: Wanted | None, calls: int
) -> KincalResult | Result:
    inputs: dict[str, Any] = {
        "method": method,
        "robot": loaded.spec.robot.model_dump(exclude_none=True),
        "samples": len(loaded.data.samples),
        "rotations": sum(sample.rotation is not None for sample in loaded.data.samples),
        "usable": loaded.problem.n,
        "targets": list(loaded.model.targets),
        "noise_given": loaded.noise,
        "payload_kg": loaded.data.payload_kg,
    }
    if loaded.problem.n < 3:
        words = f"{loaded.problem.n} of {len(loaded.data.samples)} samples have a reading of their own"
        name = "poses-not-distinct" if loaded.copies else "too-few-poses"
        return _refused(loaded, Refusal(name, words), None, inputs)
    found, inputs["solve_seconds"] = timed(partial(_estimate, loaded, method), calls)
    classic = None if isinstance(found, Solution) else found
    solution = _of_classic(loaded, found) if isinstance(found, Classic) else found
    observed = _observed(solution)
    refusal = refuse(solution.problem, observed, loaded.spec.robot.prior is not None, loaded.copies)
    if refusal is not None:
        return _refused(loaded, refusal, observed, inputs)
    check_match(loaded, solution)
    return fill_result(Solved(loaded, solution, observed, classic, query, wanted, inputs))


def _estimate(loaded: KincalSet, method: str) -> Solution | Classic:
    if method == CLASSIC:
        return solve_classic(loaded.problem)
    return identify_with_constant(loaded.problem, loaded.noise, method == ADJUSTMENT)


def _of_classic(loaded: KincalSet, found: Classic) -> Solution:
    """The classic parameters with what that method does not have: no covariance, nothing rejected."""
    problem = loaded.problem
    noise = first_noise(loaded.noise)
    determined = _observe(problem, found.x).rank + REGISTRATION
    unknowns = min(determined, 3 * problem.n - 1)
    noise = estimated(noise, found.e, problem.range_m, unknowns)
    return Solution(
        problem=problem,
        x=found.x,
        registration=found.registration,
        cov=None,
        used=np.ones(problem.n, dtype=bool),
        reasons={},
        noise=noise,
        excess=1.0,
        e=found.e,
        distance=np.sqrt(np.mean((found.e / noise.sigma(problem.range_m)) ** 2, axis=0)),
        unknowns=unknowns,
    )


def _observed(solution: Solution) -> Observability:
    """Of geometry and targets: joint errors have a size of their own from the readings, so none is open."""
    kept = solution.model.geometric
    plain = replace(solution.problem, model=solution.model.without_errors())
    found = _observe(plain.take(solution.used), solution.x[kept])
    is_open = np.zeros(len(kept), dtype=bool)
    is_open[kept] = found.open
    return replace(found, open=is_open)


def _observe(problem: Problem, x: Array) -> Observability:
    _, J = problem.model.linearised(x, problem.Q, problem.target)
    return observe(problem, J, np.ones(problem.n), x)


def _refused(
    loaded: KincalSet, refusal: Refusal, observed: Observability | None, inputs: dict[str, Any]
) -> Result:
    known: dict[str, Any] = {}
    if observed is not None:
        known = {
            "rank": observed.rank,
            "rank_possible": observed.rank_possible,
            "lacking": list(observed.lacking),
            "unidentifiable": list(observed.unidentifiable),
        }
    unusable = [{"index": loaded.indices[k], "reason": why} for k, why in sorted(loaded.unusable.items())]
    return refused(
        "kincal", refusal, loaded.warnings, inputs, unobservable=[refusal.words], **known, unusable=unusable
    )
