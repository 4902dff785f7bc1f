"""The delay of a source from the data set of a latency calibration: the one path of the job and of replay."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.latency.counts import solve_counts
from calibration.latency.crossings import SeenCrossing, solve_delay
from calibration.latency.delay import Z95, Delay, DelayUndetermined
from calibration.latency.pictures import Look, Way, solve_pictures
from calibration.targets import make_target
from cell.devices import Intrinsics
from cell.errors import error
from cell.formats.result import Result
from cell.poses import from_pose6
from procedures.belt.calibrating.rows import ItemFollower, motion_of
from procedures.latency.result import (
    LatencyAnswer,
    LatencyHeldOut,
    LatencyInputs,
    LatencyObservability,
    LatencyResiduals,
    LatencyResult,
    LatencyUncertainty,
)
from procedures.solving import within_limits
from procedures.words import ms

DATA_FILE = "latency.json"
SCHEMA = "cellward.latency/1"
BEAM_EDGES, TARGET_IN_PICTURES, BELT_SIGHTINGS = "beam-edges", "target-in-pictures", "belt-sightings"
SPEED_WINDOW_S = 0.03


@within_limits
def solve_latency(path: Path) -> LatencyResult | Result:
    """``cellward.result/1`` of kind ``latency`` from a run's folder or its ``latency.json``.

    ``time_offset_s`` is what is to be subtracted from the source's own stamps: ``applied_s``, which the
    driver has subtracted from those of the data, and the delay that is left.
    """
    file = path / DATA_FILE if path.is_dir() else path
    data = _read(file)
    inputs = LatencyInputs(
        path=str(file),
        passes=len(data.get("passes", ())),
        source=data["source"],
        camera_version=data.get("camera_version"),
        camera_calibration=data.get("camera_calibration"),
    )
    began = time.perf_counter()
    try:
        found = SIGNALS[data["signal"]](data)
    except DelayUndetermined as exc:
        return Result(kind="latency", verdict="fail", reasons=[str(exc)], result=None, inputs=inputs)
    camera = float(data.get("camera_sigma_s", 0.0))
    sigma = float(np.hypot(found.sigma_tau, camera))
    half = float(np.hypot(found.half95, Z95 * camera))
    offset = data["applied_s"] + found.tau
    held_out = found.heldout[np.isfinite(found.heldout)]
    return LatencyResult(
        verdict="pass",
        result=LatencyAnswer(
            source=data["source"],
            time_offset_s=offset,
            interval95_s=[offset - half, offset + half],
            tau=found.tau,
            applied_s=data["applied_s"],
            hysteresis_m=found.hysteresis,
        ),
        uncertainty=LatencyUncertainty(
            sigma_s=sigma,
            sigma_hysteresis_m=found.sigma_hysteresis,
            camera_sigma_s=camera or None,
            look_s=found.bias or None,
        ),
        residuals=LatencyResiduals(
            rms_m=float(np.sqrt(np.mean(found.residuals**2))),
            over_bracket=found.scatter,
            edges=len(found.residuals),
        ),
        heldout=LatencyHeldOut(rms_m=float(np.sqrt(np.mean(held_out**2))) if len(held_out) else None),
        observability=LatencyObservability(undetermined=_undetermined(data, found)),
        inputs=inputs.changed(solve_seconds=time.perf_counter() - began),
    )


def _undetermined(data: Mapping[str, Any], found: Delay) -> list[str]:
    """What these data cannot tell, in words."""
    if data["signal"] == BELT_SIGHTINGS:
        words = ["a camera that is late by more than its own interval says: it is in the answer as far"]
        return words if data.get("camera_sigma_s") else [*words, "how well the camera's delay is known"]
    words = []
    if found.bias:
        words.append(
            "where between a request and its reply the module looks: the interval has "
            f"{ms(found.bias)} to either side for it"
        )
    if found.hysteresis is None:
        words.append("the hysteresis: with one speed it is part of the delay")
    return words


def of_beam(data: Mapping[str, Any]) -> Delay:
    """From the edges of the tool in a beam."""
    return solve_delay(beam_edges(data))


def of_pictures(data: Mapping[str, Any]) -> Delay:
    """From pictures of a target on ways of the arm."""
    points = make_target(data["target"]).points
    lens = data["camera"]
    fx, fy, cx, cy = lens["K"]
    camera = Intrinsics(lens["width"], lens["height"], (fx, fy, cx, cy), tuple(lens["dist"]))
    ways, looks = [], []
    for k, entry in enumerate(data["passes"]):
        T = from_pose6(np.array(entry["pose"])).as_matrix()
        t = np.array(entry["pose_t"])
        new = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0.0)  # stamps of a burst may be one
        ways.append(Way(entry["pair"], entry["dir"], entry["speed"], t[new], T[new]))
        looks += [
            Look(k, shot["t"], shot["row_time_s"], points[shot["ids"]], np.array(shot["corners"]))
            for shot in entry["frames"]
        ]
    return solve_pictures(data["setup"], camera, from_pose6(data["X"]).as_matrix(), ways, looks)


def of_belt(data: Mapping[str, Any]) -> Delay:
    """From sightings of items and the counts of their belt."""
    encoder = np.array(data["encoder"], dtype=float).reshape(-1, 2)
    T = from_pose6(data["T_base_camera"])
    motion = motion_of(data.get("configured"))
    follower = ItemFollower(motion, 0.0)  # looks while the belt stands tell where an item is
    for look in data["sightings"]:
        if not len(encoder) or not encoder[0, 0] < look["t"] < encoder[-1, 0]:
            continue
        times = [look["t"] + late for late in look["after_s"]]
        counts = np.interp([look["t"], *times], encoder[:, 0], encoder[:, 1])
        each = list(zip(times, counts[1:].tolist(), strict=True))
        follower.add(look["t"], float(counts[0]), T.apply(np.array(look["points"])), each)
    rows = follower.rows()
    if not len(rows.t):
        raise DelayUndetermined("too-few-sightings: the camera saw no item while the counts came")
    if motion is None:  # the way that the items go
        moved = np.concatenate([rows.points[rows.items == i] for i in np.unique(rows.items)])
        motion = np.linalg.svd(moved - moved.mean(axis=0))[2][0]
    along = rows.points @ (motion / np.linalg.norm(motion))
    return solve_counts(rows.t, along, rows.items, encoder[:, 0], encoder[:, 1])


def beam_edges(data: Mapping[str, Any]) -> list[SeenCrossing]:
    """What the passes of a beam show, each edge of the tool at its place."""
    return [c for k, entry in enumerate(data["passes"]) for c in crossings_of(k, entry, data["across"])]


def crossings_of(way: int, entry: Mapping[str, Any], across: Sequence[float]) -> list[SeenCrossing]:
    """The edges of one PASS (see ``cellward.laser/1``), which is ``way``, in their order in space."""
    t, x = np.array(entry["pose_t"]), np.array(entry["pose_xyz"]) @ np.array(across)
    poll_t, poll_dt = np.array(entry["poll_t"]), np.array(entry["poll_dt"])
    changed = np.flatnonzero(np.diff(entry["poll_v"]))
    found: list[SeenCrossing] = []
    for i in changed[:: entry["dir"]]:
        low, high = poll_t[i : i + 2]
        seen, look = 0.5 * (low + high), 0.5 * float(poll_dt[i] + poll_dt[i + 1])
        near = np.abs(t - seen) <= max(SPEED_WINDOW_S, high - low + 2.0 * look)
        speed = abs(float(np.polyfit(t[near] - seen, x[near], 1)[0]))
        at = float(np.interp(seen, t, x))
        edge = len(found), entry["dir"], speed, at, 0.5 * float(high - low), look
        found.append(SeenCrossing(way, *edge))
    return found


def _read(file: Path) -> dict[str, Any]:
    try:
        data = json.loads(file.read_text("utf-8"))
    except FileNotFoundError:
        raise error(
            "FILE_MISSING", f"{file} does not exist; give the folder of a latency calibration"
        ) from None
    except (OSError, ValueError) as exc:
        raise error("FILE_UNREADABLE", f"{file} cannot be read: {exc}") from exc
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise error("DATA_INVALID", f"{file} is no {SCHEMA}")
    if (signal := data.setdefault("signal", BEAM_EDGES)) not in SIGNALS:
        raise error("DATA_INVALID", f"{file}: signal is {signal!r}; it must be one of {', '.join(SIGNALS)}")
    return data


# How the data set of a source becomes its delay, by the name that it gives as its signal.
SIGNALS: dict[str, Callable[[Mapping[str, Any]], Delay]] = {
    BEAM_EDGES: of_beam,
    TARGET_IN_PICTURES: of_pictures,
    BELT_SIGHTINGS: of_belt,
}
