"""A measured delay beside the twin's truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.store.files import read_json
from procedures.beside_truth import SURE_SCALAR, Judged
from procedures.latency.result import LatencyResult


def judge_delay(result: LatencyResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """The offset against the source's own delay; good within the 95 % interval, widened to ``SURE``."""
    of, true = _true_delay(truth, read_json(folder / "run.json")["job_config"])
    answer = result.result
    low, high = answer.interval95_s
    off, half = answer.time_offset_s - true, (high - low) / 2.0
    good = abs(off) <= SURE_SCALAR * half
    words = "consistent with" if good else "NOT consistent with"
    text = (
        f"the delay is {1e3 * answer.time_offset_s:.3f} ms, of {of} truly {1e3 * true:.3f} ms; off by "
        f"{1e3 * off:.3f} ms\n{words} the stated 95 % interval, {1e3 * low:.3f} to {1e3 * high:.3f} ms"
    )
    return Judged(
        good,
        text,
        f"{of} late by {1e3 * answer.time_offset_s:.2f} ms +- {1e3 * half:.2f} ms (95 %)",
        f"{1e3 * abs(off):.3f} ms",
        abs(off) <= half,
        {"delay": abs(off) / half},
        {"delay": (half, "s")},
    )


def _true_delay(truth: Mapping[str, Any], job: Mapping[str, Any]) -> tuple[str, float]:
    """What was measured, and how late it is against the arm's stamps, s (record 0062)."""
    source, arm = job["source"], float(truth["robot"].get("stamp_late_s", 0.0))
    if source == "beams":
        # The module takes a level over after its filter, and on average half a scan later.
        module = truth.get("io", {})
        late = float(module.get("filter_s", 0.0)) + 0.5 * float(module.get("scan_s", 0.0))
        return f"beam {job['beam']}", float(truth["beams"][job["beam"]]["latency_s"]) + late - arm
    if source == "belt":
        belt = truth["belt"]
        return "the encoder", float(belt["late_s"] + 0.5 * belt["jitter_s"]) - arm
    return "the camera", float(truth["camera"]["stamp_late_s"]) - arm
