"""A measured delay beside the twin's truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.store.files import read_json
from procedures.beside_truth import SURE_SCALAR, Judged
from procedures.latency.result import LatencyResult


def judge_delay(result: LatencyResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """The offset against the sensor's own delay; good within the 95 % interval, widened to 99.73 %."""
    beam = read_json(folder / "run.json")["job_config"]["beam"]
    answer, true = result.result, float(truth["beams"][beam]["latency_s"])
    low, high = answer.interval95_s
    off, half = answer.time_offset_s - true, (high - low) / 2.0
    good = abs(off) <= SURE_SCALAR * half
    words = "consistent with" if good else "NOT consistent with"
    text = (
        f"the delay is {1e3 * answer.time_offset_s:.3f} ms, of beam {beam} truly {1e3 * true:.3f} ms; off by "
        f"{1e3 * off:.3f} ms\n{words} the stated 95 % interval, {1e3 * low:.3f} to {1e3 * high:.3f} ms"
    )
    return Judged(
        good, text, f"95 % within {1e3 * half:.3f} ms", f"{1e3 * abs(off):.3f} ms", abs(off) <= half
    )
