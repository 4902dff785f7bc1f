"""The delay of a source from the passes of a latency calibration: the one path of the job and of replay."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.latency import SeenCrossing, solve_delay, undetermined
from cell.errors import error
from cell.formats.result import Result
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

DATA_FILE = "latency.json"
SCHEMA = "cellward.latency/1"
BEAM_EDGES = "beam-edges"
SPEED_WINDOW_S = 0.03


@within_limits
def solve_latency(path: Path) -> LatencyResult | Result:
    """``cellward.result/1`` of kind ``latency`` from a run's folder or its ``latency.json``.

    ``time_offset_s`` is what is to be subtracted from the source's own stamps: ``applied_s``, which the
    driver has subtracted from those of the data, and the delay that is left.
    """
    file = path / DATA_FILE if path.is_dir() else path
    data = _read(file)
    crossings = SIGNALS[data["signal"]](data)
    inputs = LatencyInputs(path=str(file), passes=len(data["passes"]), source=data["source"])
    if (why := undetermined(crossings)) is not None:
        return Result(kind="latency", verdict="fail", reasons=[why], result=None, inputs=inputs)
    began = time.perf_counter()
    found = solve_delay(crossings)
    low, high = (data["applied_s"] + t for t in found.interval95)
    held_out = found.heldout[np.isfinite(found.heldout)]
    return LatencyResult(
        verdict="pass",
        result=LatencyAnswer(
            source=data["source"],
            time_offset_s=data["applied_s"] + found.tau,
            interval95_s=[low, high],
            tau=found.tau,
            applied_s=data["applied_s"],
            hysteresis_m=found.hysteresis,
        ),
        uncertainty=LatencyUncertainty(sigma_s=found.sigma_tau, sigma_hysteresis_m=found.sigma_hysteresis),
        residuals=LatencyResiduals(
            rms_m=float(np.sqrt(np.mean(found.residuals**2))),
            over_bracket=found.scatter,
            edges=len(crossings),
        ),
        heldout=LatencyHeldOut(rms_m=float(np.sqrt(np.mean(held_out**2))) if len(held_out) else None),
        observability=LatencyObservability(
            undetermined=[]
            if found.hysteresis is not None
            else ["the hysteresis: with one speed it is part of the delay"]
        ),
        inputs=inputs.changed(solve_seconds=time.perf_counter() - began),
    )


def beam_edges(data: Mapping[str, Any]) -> list[SeenCrossing]:
    """What the passes of a beam show, each edge of the tool at its place."""
    return [c for entry in data["passes"] for c in crossings_of(entry, data["across"])]


def crossings_of(entry: Mapping[str, Any], across: Sequence[float]) -> list[SeenCrossing]:
    """The edges of one PASS (see ``cellward.laser/1``), in their order in space."""
    t, x = np.array(entry["pose_t"]), np.array(entry["pose_xyz"]) @ np.array(across)
    poll_t, poll_dt = np.array(entry["poll_t"]), np.array(entry["poll_dt"])
    changed = np.flatnonzero(np.diff(entry["poll_v"]))
    found: list[SeenCrossing] = []
    for i in changed[:: entry["dir"]]:
        low, high = poll_t[i] - poll_dt[i], poll_t[i + 1] + poll_dt[i + 1]
        seen = 0.5 * (low + high)
        near = np.abs(t - seen) <= max(SPEED_WINDOW_S, high - low)
        speed = abs(float(np.polyfit(t[near] - seen, x[near], 1)[0]))
        found.append(
            SeenCrossing(len(found), entry["dir"], speed, float(np.interp(seen, t, x)), 0.5 * (high - low))
        )
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


# How the data set of a source becomes crossings, by the name that it gives as its signal.
SIGNALS: dict[str, Callable[[Mapping[str, Any]], list[SeenCrossing]]] = {BEAM_EDGES: beam_edges}
