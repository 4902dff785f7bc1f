"""A run's data solved and judged again as the job did it: the same files, limits and values."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cell.errors import error

Info = Mapping[str, Any]
Again = Callable[[Path, Info, Info], dict[str, Any]]


def solve_again(job: str, folder: Path, info: Info, recorded: Info) -> dict[str, Any]:
    """The result document of a run from its folder; ``info`` is its ``run.json``, ``recorded`` its result.

    ``NOT_FOUND`` when the run has no data set, or its job none at all.
    """
    if job not in _JOBS:
        raise error("NOT_FOUND", f"a {job} has nothing to solve again")
    name, again = _JOBS[job]
    if not (folder / name).exists():
        raise error("NOT_FOUND", f"{folder.name} ({job}) has no {name} to solve")
    return again(folder / name, info, recorded)


def _capture(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.cone_capture.verdict import judged
    from procedures.solve.hand_eye import solve_hand_eye

    again = solve_hand_eye(path, method=(recorded.get("inputs") or {}).get("method"))
    limits = (info.get("job_config") or {}).get("accept")
    return judged(again, limits) if limits else again


def _reference(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.laser.config import LaserReferenceConfig
    from procedures.laser.reference import known_of, solved_reference

    config = LaserReferenceConfig.model_validate(info["job_config"])
    known = known_of(config, info["values"], info["config"]["robot"]["beams"])
    return solved_reference(path, known, info["job_config"])


def _check(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.laser.check import known_of, solved_check

    return solved_check(path, known_of(info["values"]), info["job_config"])


def _update(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.laser.update import solved_update

    return solved_update(path, info["values"], info["job_config"], recorded)


def _latency(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.latency.procedure import solve_within_limits

    return solve_within_limits(path, info["job_config"]["accept"])


def _tracker(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.tracker.judging import solve_within_limits

    return solve_within_limits(path, info["job_config"])


def _belt(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.belt.calibration_solving import solve_within_limits

    return solve_within_limits(path, info["job_config"])


def _picking(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    """What was picked is in journal and ledger; solved is where items were predicted to be."""
    from procedures.belt.predicted import predicted

    return {**recorded, **predicted(path)}


def _iso9283(path: Path, info: Info, recorded: Info) -> dict[str, Any]:
    from procedures.iso9283.judging import solve_iso9283

    return solve_iso9283(path, {key: info["job_config"].get(key) for key in ("max_AP_m", "max_RP_m")})


_JOBS: dict[str, tuple[str, Again]] = {
    "belt-calibration": ("belt.json", _belt),
    "belt-tracking": ("intercept.json", _picking),
    "cone-capture": ("capture.json", _capture),
    "laser-reference": ("laser.json", _reference),
    "laser-check": ("laser.json", _check),
    "laser-update": ("laser.json", _update),
    "iso9283": ("iso9283.json", _iso9283),
    "latency-calibration": ("latency.json", _latency),
    "tracker-sampling": ("kincal.json", _tracker),
}
