"""What is asked of a calibrated arm: where the tracker would see it, and which joints reach a pose."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.identification.application import goals_from_yaw, reach, yaw_of
from calibration.identification.model import LENGTH_M
from calibration.identification.solution import Solution, predict
from calibration.kinematics.ur_models import JOINT_LIMITS
from calibration.lengths import lengths95
from cell.errors import error
from cell.formats.kincal import QUERY_SCHEMA, TARGETS_SCHEMA, KincalQuery, KincalTargets
from cell.formats.reading import parse, read_json
from cell.poses import Array, from_pose6
from procedures.tracker.solve.data import FAR_P, FAR_Q, KincalSet, slowest_gear

_TILT = 2e-3  # rad
_MARGIN = 0.1  # of a joint's sampled range

Warnings = list[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class Query:
    """Joints ``Q`` (n, j) whose readings of ``target`` are wanted; where no sample has it, ``place`` (3,) is
    at its nominal place, to ``place_sd`` along each axis, m."""

    Q: Array
    target: str
    place: Array | None
    place_sd: float


@dataclass(frozen=True, eq=False)
class Wanted:
    """Flange poses ``goals`` (k, 4, 4) in the base; ``level`` says that only the heading is asked for."""

    goals: Array
    q_near: Array | None
    level: bool


def load_query(path: Path, loaded: KincalSet) -> Query:
    """``cellward.kincal-query/1`` for the arm of the data set."""
    query = parse(KincalQuery, read_json(path), QUERY_SCHEMA, str(path))
    Q = _joints(path, "q", query.q, loaded.spec.arm.joints)
    known = sorted({*loaded.model.targets, *loaded.spec.tools})
    target = query.target or (loaded.model.targets[0] if len(loaded.model.targets) == 1 else None)
    if target is None or target not in known:
        said = "is missing" if target is None else f"{target!r} is not known"
        raise error("DATA_INVALID", f"{path}: target {said}; there is {', '.join(known)}")
    if np.any(np.abs(Q * slowest_gear(loaded.spec.arm.base)) > FAR_Q):
        text = f"a joint of {path.name} is beyond 4 pi rad: are the angles in degrees?"
        loaded.warnings.append(("units.rotation", text))
    place = None if target in loaded.model.targets else loaded.spec.tools[target]
    return Query(Q, target, place, loaded.spec.prior.length_m or LENGTH_M)


def load_targets(path: Path, loaded: KincalSet) -> Wanted:
    """``cellward.kincal-targets/1`` for the arm of the data set."""
    asked = parse(KincalTargets, read_json(path), TARGETS_SCHEMA, str(path))
    joints = loaded.spec.arm.joints
    level = joints == 4
    if joints < 4 or joints == 5:
        raise error(
            "DATA_INVALID", f"{path}: an arm with {joints} joints cannot reach a pose; 4, 6 or more can"
        )
    goals = np.empty((len(asked.targets), 4, 4))
    for k, target in enumerate(asked.targets):
        if len(target) == 6:
            goals[k] = from_pose6(target).as_matrix()
        elif level:
            goals[k] = goals_from_yaw(np.array([target]))[0]
        else:
            raise error(
                "DATA_INVALID",
                f"{path}: targets[{k}] has 4 numbers; an arm with {joints} joints needs x, y, z, rx, ry, rz",
            )
    if np.any(np.abs(goals[:, :3, 3]) > FAR_P):
        text = f"a place of {path.name} is more than {FAR_P:.0f} m away: are the lengths in millimetres?"
        loaded.warnings.append(("units.translation", text))
    if any(np.linalg.norm(target[3:]) > FAR_Q for target in asked.targets):
        text = f"an attitude of {path.name} is beyond 4 pi rad: are the angles in degrees?"
        loaded.warnings.append(("units.rotation", text))
    near = None if asked.q_near is None else _joints(path, "q_near", asked.q_near, joints)
    return Wanted(goals, near, level)


def _joints(path: Path, name: str, rows: list[list[float]], joints: int) -> Array:
    for k, row in enumerate(rows):
        if len(row) != joints:
            raise error("DATA_INVALID", f"{path}: {name}[{k}] has {len(row)} joints; the robot has {joints}")
    return np.array(rows, dtype=float).reshape(-1, joints)


def answer_query(solution: Solution, query: Query) -> tuple[dict[str, object], Warnings]:
    """``p_tracker`` and, where there is a covariance, what 95 % of errors stay below; and warnings."""
    model, x, cov = solution.model, solution.x, solution.cov
    if query.place is None:
        p, own = solution.predict(query.Q, model.targets.index(query.target))
    else:  # the arm is known, this reflector's place is as given
        moved = x.copy()
        moved[model.tool_rows()[:3]] = query.place
        p, own = predict(model, moved, solution.registration, cov, query.Q, 0)
        own = None if own is None else own + query.place_sd**2 * np.eye(3)
    answer: dict[str, object] = {"p_tracker": p.tolist()}
    if own is not None:
        answer["p_tracker_95"] = lengths95(own, solution.freedom).tolist()
    warnings = _beyond_samples(solution, query.Q, "predict")
    if query.place is not None:
        known = f"its place on the flange is the nominal one, to {1e3 * query.place_sd:.3g} mm"
        text = f"no sample has {query.target}; {known}"
        warnings.append(("predict.unmeasured", text))
    return answer, warnings


def _beyond_samples(solution: Solution, Q: Array, asked: str) -> Warnings:
    """That joints ``Q`` (k, j), NaN where there are none, are not among those that were sampled: the model is
    believed there, and nothing checks it."""
    sampled = solution.problem.Q[solution.used]
    low, high = sampled.min(axis=0), sampled.max(axis=0)
    off = np.maximum(low - Q, Q - high)
    out = off > _MARGIN * (high - low)
    rows = np.flatnonzero(np.any(out, axis=1))
    if not len(rows):
        return []
    joints = ", ".join(str(j + 1) for j in np.flatnonzero(np.any(out, axis=0)))
    text = (
        f"{_listed(rows)} of --{asked} are outside the sampled ranges of joint {joints}; nothing checks them"
    )
    return [(f"{asked}.beyond-samples", text)]


def answer_targets(solution: Solution, wanted: Wanted) -> tuple[dict[str, object], Warnings]:
    """``q`` for the wanted poses, null where out of reach, and what is to be warned of."""
    model = solution.model
    chain = model.arm.chain(solution.x[: len(model.arm.names)])
    if not len(wanted.goals):
        return {"q": []}, []
    found = reach(chain, wanted.goals, wanted.q_near, solution.problem.Q, wanted.level)
    warnings = _beyond_samples(solution, found.q, "targets")
    lost = np.flatnonzero(~found.found)
    if len(lost):
        warnings.append(
            (
                "targets.unreachable",
                f"targets {_listed(lost)} are out of the calibrated arm's reach, or too far from q_near; "
                "q is null there",
            )
        )
    if model.arm.family == "ur":
        beyond = np.flatnonzero(
            np.any((found.q < JOINT_LIMITS[:, 0]) | (found.q > JOINT_LIMITS[:, 1]), axis=1) & found.found
        )
        if len(beyond):
            text = f"targets {_listed(beyond)} need joints beyond the arm's limits; choose another q_near"
            warnings.append(("targets.joint-limit", text))
    if wanted.level and np.any(found.found):
        reached = chain.flange(found.q[found.found])
        flat = goals_from_yaw(np.column_stack([reached[:, :3, 3], yaw_of(wanted.goals[found.found])]))
        upright = np.sum(wanted.goals[found.found][:, :3, 2] * flat[:, :3, 2], axis=1)
        tilt = np.arccos(np.clip(upright, -1, 1))
        if np.max(tilt) > _TILT:
            by = np.degrees(tilt.max())
            text = f"the flange of this arm stays level; wanted poses are tilted by up to {by:.2f} deg"
            warnings.append(("targets.tilt", text))
    q = [None if np.any(np.isnan(row)) else [float(v) for v in row] for row in found.q]
    return {"q": q}, warnings


def _listed(rows: NDArray[np.int64]) -> str:
    shown = ", ".join(str(int(k)) for k in rows[:8])
    return f"{shown} and {len(rows) - 8} more" if len(rows) > 8 else shown
