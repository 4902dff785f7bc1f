"""What of a measured pose is kept beside its point."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np

from cell.formats.kincal import SCHEMA, Kincal
from cell.formats.reading import parse
from cell.formats.tracker_samples import as_data_set
from cell.laser_tracker import StablePoint
from cell.samples import Sample
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.plan import Visit
from procedures.tracker.visiting import Visitor


def kept_of(point: StablePoint) -> dict[str, Any]:
    """The sample that a pose with ``point`` becomes."""
    kept: list[dict[str, Any]] = []
    record = SimpleNamespace(samples=[], add_sample=kept.append)
    run = SimpleNamespace(note=lambda *about, **more: None)
    place = SimpleNamespace(refine=lambda samples: None)
    config = TrackerSamplingConfig.model_construct(pose_tolerance_rad=0.01)
    subject: Any = Visitor(run, config, None, None, place, record, list)  # type: ignore[arg-type]
    asyncio.run(subject.keep(Visit([0.0] * 6, "smr1", False, []), np.zeros(6), Sample(point, 10.0, 0.75, 1)))
    return kept[0]


def test_the_uncertainty_that_the_sender_states_is_kept_with_the_pose() -> None:
    kept = kept_of(StablePoint(np.array([0.0, 3.0, 4.0]), 0.0, 1, 1.5, sigma_m=5e-6))
    assert kept["notes"] | {"readings": 1, "window_s": 1.5, "sigma_m": 5e-6} == kept["notes"]


def test_the_rotation_of_a_six_degree_target_is_kept_in_the_data_set_where_there_is_one() -> None:
    point = np.array([0.0, 3.0, 4.0])
    kept = kept_of(StablePoint(point, 0.0, 1, 1.5, rotation=np.array([0.1, -0.2, 3.0])))
    data = as_data_set({"robot": {"model": "ur10e"}}, [kept], aside=False)
    assert parse(Kincal, data, SCHEMA, "kincal.json").samples[0].rotation == [0.1, -0.2, 3.0]
    assert "rotation" not in kept_of(StablePoint(point, 0.0, 1, 1.5))
