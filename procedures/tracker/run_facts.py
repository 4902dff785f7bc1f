"""What a result says of the way it was measured; in the data sets, so that replay says the same."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.monuments import drift_summary, first_seen
from procedures.tracker.plan import Visit
from procedures.tracker.record import SampleRecord
from procedures.tracker.stored import StoredSet


def facts(
    config: TrackerSamplingConfig,
    record: SampleRecord,
    stored: StoredSet | None,
    *,
    off_plan: int,
    lost: Sequence[tuple[Visit, str]],
    predicted: Mapping[str, Any] | None,
    devices: Mapping[str, Any],
) -> dict[str, Any]:
    """``notes.sampling`` of the data sets: ``devices`` and their serials, what was wanted and what became of
    it, where the tracker stood and whether it stood still."""
    return {
        **devices,
        "role": config.arm,
        "joint_ranges_rad": config.joint_ranges_rad,
        "joints_sampled_rad": _sampled(record, stored),
        "wanted": config.poses,
        "measured": len(record.samples),
        "set_aside": sum(bool(s["held_out"]) for s in record.samples),
        "off_plan": off_plan,
        "doubtful": [
            {"index": s["index"], "warnings": s["notes"]["warnings"]}
            for s in record.samples
            if s["notes"].get("warnings")
        ],
        "lost": [{"q": visit.q, "target": visit.reflector, "why": why} for visit, why in lost],
        "T_base_tracker": record.T_base_tracker,
        "predicted": predicted,
        "stored": stored and {"path": str(stored.path), "samples": len(stored.samples)},
        "reflectors": {name: list(r.point) for name, r in config.reflectors.items()},
        "monument_points": first_seen(record.looks),
        "monuments": drift_summary(record.looks, config.max_drift_m, len(record.samples)),
    }


def _sampled(record: SampleRecord, stored: StoredSet | None) -> list[list[float]] | None:
    """[lowest, highest] of each joint (rad) at the poses that are solved; None without any."""
    solved = [s["q"] for s in record.samples if not s["held_out"]]
    solved += [s["q"] for s in stored.samples] if stored else []
    return np.column_stack([np.min(solved, axis=0), np.max(solved, axis=0)]).tolist() if solved else None
