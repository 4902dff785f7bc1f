"""A kinematic data set in memory: joints, tracker points, and the arm that they belong to."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from calibration.identification.estimator import Problem
from calibration.identification.model import Model, make_model
from calibration.identification.registration import robust_register
from calibration.identification.solution import Solution
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import ArmSpec, arm_spec
from cell.errors import error
from cell.formats.kincal import SCHEMA, Kincal
from cell.formats.reading import parse, read_json
from cell.formats.robot import PalletizerRobot, parse_robot
from cell.formats.tracker_samples import FILE_NAME as LINES_NAME
from cell.poses import Array
from procedures.tracker.solve.copies import copies_of, copies_warning
from procedures.tracker.solve.tables import is_table, read_table

FILE_NAME = "kincal.json"
FAR_P, FAR_Q = 20.0, 4.0 * np.pi
_ONE_TARGET = "smr1"
_FEW = 3  # fewer points say nothing about units
_MISFIT = 0.05  # of the points' spread: no arm is that far from its nominal model
_BETTER = 0.3


@dataclass
class KincalSet:
    """Row k of ``Q`` (n, j), ``p`` (3, n) and ``target`` (n,) is sample ``rows[k]``; ``unusable`` samples
    have no reading of their own, ``copies`` of them because they repeat another one."""

    path: Path
    data: Kincal
    spec: ArmSpec
    problem: Problem
    rows: list[int]
    unusable: dict[int, str] = field(default_factory=dict)
    copies: int = 0
    warnings: list[tuple[str, str]] = field(default_factory=list)

    @property
    def model(self) -> Model:
        return self.problem.model

    @cached_property
    def indices(self) -> list[int]:
        """The data set's own number of every sample."""
        return [_number(self.data, k) for k in range(len(self.data.samples))]

    @property
    def noise(self) -> dict[str, float]:
        """Given noise levels."""
        given = {} if self.data.noise is None else self.data.noise.model_dump(exclude_none=True)
        return {k: float(v) for k, v in given.items()}


def load_kincal(path: Path, robot: Path | None = None) -> KincalSet:
    """Read and check a data set: a folder with kincal.json, a JSON file, CSV or MATLAB columns.

    Of a run that ended before its kincal.json was written, the poses that it had finished.

    ``robot`` is a file with a ROBOT, which CSV and MATLAB need and which goes before the one in the data.
    Raises an ``InputError`` that names file, field and fix.
    """
    file, data = read_kincal(path)
    spec = _robot(file, data, robot)
    _check_lengths(file, spec)
    names = _targets(file, data, spec)
    unusable = {
        k: "the tracker had no reading"
        for k, s in enumerate(data.samples)
        if s.p_tracker is None or None in s.p_tracker
    }
    copies = copies_of(data, names, unusable)
    unusable |= {k: f"a copy of sample {_number(data, first)}" for k, first in copies.items()}
    rows = [k for k in range(len(data.samples)) if k not in unusable]
    _check_joints(file, data, spec)
    used = [names[k] for k in rows]
    targets = list(dict.fromkeys(used)) or [_ONE_TARGET]
    problem = Problem(
        make_model(spec, targets),
        np.array([data.samples[k].q for k in rows]).reshape(len(rows), spec.arm.joints),
        np.array([data.samples[k].p_tracker for k in rows], dtype=float).reshape(len(rows), 3).T.copy(),
        np.array([targets.index(name) for name in used], dtype=np.int64),
    )
    loaded = KincalSet(file, data, spec, problem, rows, unusable, len(copies))
    if copies:
        loaded.warnings.append(copies_warning(len(copies)))
    if file.name == LINES_NAME:
        loaded.warnings.append(("samples.interrupted", _ended_early(data)))
    _check_units(loaded)
    if problem.model.unknown_tools:
        listed = ", ".join(problem.model.unknown_tools)
        text = f"the robot's 'tool' has no place for {listed}; it was estimated from nothing"
        loaded.warnings.append(("tool.unknown", text))
    return loaded


def read_kincal(path: Path) -> tuple[Path, Kincal]:
    """The file and its samples, without the arm; raises an ``InputError``."""
    file = path / FILE_NAME if path.is_dir() else path
    if file.name == FILE_NAME and not file.exists() and file.with_name(LINES_NAME).exists():
        file = file.with_name(LINES_NAME)
    if file.name == LINES_NAME:
        raw = _finished_poses(file)
    else:
        raw = read_table(file) if is_table(file) else read_json(file)
    return file, parse(Kincal, raw, SCHEMA, str(file))


def _finished_poses(file: Path) -> dict[str, Any]:
    from procedures.tracker.record import SampleRecord  # whose package solves with this module

    if not file.is_file():
        raise error("FILE_MISSING", f"{file} does not exist; give the path of a data set")
    return SampleRecord.read(file.parent).left()


def _ended_early(data: Kincal) -> str:
    finished, doubted = data.notes["finished"], data.notes["doubted"]
    aside = finished - doubted - len(data.samples)
    text = f"the run ended early: of its {finished} finished poses {aside} were set aside to judge"
    return text + (f", and for {doubted} no look at the monuments vouches" if doubted else "")


def _robot(file: Path, data: Kincal, robot: Path | None) -> ArmSpec:
    if robot is not None:
        raw: Any = read_json(robot)
        inner = raw.get("robot")
        where = f"{robot}: robot" if isinstance(inner, dict) else str(robot)
        raw = inner if isinstance(inner, dict) else {k: v for k, v in raw.items() if k != "schema"}
    elif data.robot is not None:
        raw, where = data.robot, f"{file}: robot"
    else:
        raise error(
            "DATA_INVALID", f"{file} does not say what arm it is of; give its ROBOT with --robot FILE"
        )
    return arm_spec(parse_robot(raw, where), where)


def _targets(file: Path, data: Kincal, spec: ArmSpec) -> list[str]:
    """The target of every sample; one that is not named must be the only one."""
    named = {s.target for s in data.samples if s.target is not None}
    known = sorted(named | set(spec.tools)) if named else sorted(spec.tools)
    if len(spec.tools) == 1 and spec.tool_in_parameters and not named:
        known = [spec.tool_in_parameters]
    nameless = [k for k, s in enumerate(data.samples) if s.target is None]
    if nameless and len(known) > 1:
        raise error(
            "DATA_INVALID",
            f"{file}: samples[{nameless[0]}].target is missing, and there are {', '.join(known)}; name it",
        )
    only = known[0] if known else _ONE_TARGET
    return [only if s.target is None else s.target for s in data.samples]


def _number(data: Kincal, k: int) -> int:
    """The data set's own number of a sample."""
    own = data.samples[k].index
    return k if own is None else own


def _check_joints(file: Path, data: Kincal, spec: ArmSpec) -> None:
    joints = spec.arm.joints
    for k, sample in enumerate(data.samples):
        if len(sample.q) != joints:
            raise error(
                "DATA_INVALID",
                f"{file}: samples[{k}].q has {len(sample.q)} joints; the robot has {joints}",
            )


def _check_units(loaded: KincalSet) -> None:
    """Warn of angles and lengths that look like degrees and millimetres; refuse what certainly is."""
    problem = loaded.problem
    if problem.n < _FEW:
        return
    index = loaded.indices
    gear = slowest_gear(problem.model.arm.base)
    turned = np.flatnonzero(np.max(np.abs(problem.Q * gear), axis=1) > FAR_Q)
    far = np.flatnonzero(problem.range_m > FAR_P)
    _refuse_other_units(loaded, bool(len(turned)))
    if len(far):
        text = f"p_tracker of sample {index[loaded.rows[far[0]]]} is more than {FAR_P:.0f} m from the tracker"
        loaded.warnings.append(
            ("units.translation", f"{text} ({len(far)} such): are the lengths in millimetres?")
        )
    if len(turned):
        text = f"a joint of sample {index[loaded.rows[turned[0]]]} is beyond 4 pi rad"
        loaded.warnings.append(("units.rotation", f"{text} ({len(turned)} such): are the angles in degrees?"))


def _check_lengths(file: Path, spec: ArmSpec) -> None:
    """Links of a chain may be hundreds of metres in pure DH form; places and a palletizer's links may not."""
    far = [f"tool {name}" for name, place in spec.tools.items() if np.max(np.abs(place)) > FAR_P]
    if isinstance(spec.robot, PalletizerRobot):
        arm = spec.arm
        far += [
            name
            for name, kind, v in zip(arm.names, arm.kinds, arm.nominal, strict=True)
            if kind == "length" and abs(v) > FAR_P
        ]
    if far:
        raise error(
            "DATA_INVALID",
            f"{file}: {far[0]} of the robot is longer than {FAR_P:.0f} m; write metres, not millimetres",
        )


def slowest_gear(chain: SerialChain) -> Array:
    """(j,): how far the links turn for one turn of a motor, at most once."""
    return np.asarray(np.minimum(np.max(np.abs(chain.coupling), axis=0), 1.0))


def _refuse_other_units(loaded: KincalSet, turned: bool) -> None:
    """``DATA_INVALID`` when the nominal arm fits far better with degrees, millimetres or a mirrored frame."""
    own = _misfit(loaded.problem, 1.0, 1.0, 1.0)
    if own < _MISFIT:
        return
    options = {
        (1.0, 1e-3, 1.0): "p_tracker is in millimetres; divide it by 1000",
        (
            1.0,
            1.0,
            -1.0,
        ): "p_tracker is in a left-handed frame; swap two of its axes or change the sign of one",
    }
    if turned or np.max(np.abs(loaded.problem.Q)) > 2.0 * np.pi:
        degrees = float(np.pi / 180.0)
        options[degrees, 1.0, 1.0] = "q is in degrees; write radians"
        options[degrees, 1e-3, 1.0] = "q is in degrees and p_tracker in millimetres; write rad and m"
    misfits = {option: _misfit(loaded.problem, *option) for option in options}
    best = min(misfits, key=misfits.__getitem__)
    if misfits[best] < _BETTER * own and misfits[best] < 4.0 * _MISFIT:
        raise error("DATA_INVALID", f"{loaded.path}: {options[best]} (the nominal arm fits then)")


def _misfit(problem: Problem, q_unit: float, p_unit: float, hand: float) -> float:
    """Median distance of the nominal arm's points from the tracker's, over the spread of the arm's."""
    model = problem.model
    f = model.points(model.nominal, q_unit * problem.Q, problem.target)
    p = p_unit * problem.p * np.array([[1.0], [1.0], [hand]])
    spread = float(np.sqrt(np.mean(np.sum((f - f.mean(axis=1, keepdims=True)) ** 2, axis=0))))
    place = robust_register(p, f, np.ones(problem.n))
    off = np.sqrt(np.sum((place.to_tracker(f) - p) ** 2, axis=0))
    return float(np.median(off)) / max(spread, 1e-9)


def check_match(loaded: KincalSet, solution: Solution) -> None:
    """Refuse joints that do not belong to the points: even the adjusted arm is nowhere near."""
    p = solution.problem.p[:, solution.used]
    off = float(np.median(np.sqrt(np.sum(solution.e[:, solution.used] ** 2, axis=0))))
    spread = float(np.sqrt(np.mean(np.sum((p - p.mean(axis=1, keepdims=True)) ** 2, axis=0))))
    if off > _MISFIT * max(spread, 1e-9):
        raise error(
            "DATA_INVALID",
            f"{loaded.path}: q does not belong to p_tracker: after calibration the points are still "
            f"{1e3 * off:.1f} mm off (median) in a cloud of {1e3 * spread:.0f} mm; check the order of the "
            "samples, the robot, and the order, signs and zero positions of its joints",
        )
