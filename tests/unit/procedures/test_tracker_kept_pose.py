"""What of a measured pose is kept beside its point."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np

from cell.devices import StablePoint
from cell.samples import Sample
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.plan import Visit
from procedures.tracker.visiting import Visitor


def test_the_uncertainty_that_the_sender_states_is_kept_with_the_pose() -> None:
    kept: list[dict[str, Any]] = []
    record = SimpleNamespace(samples=[], add_sample=kept.append)
    run = SimpleNamespace(note=lambda *about, **more: None)
    place = SimpleNamespace(refine=lambda samples: None)
    config = TrackerSamplingConfig.model_construct(pose_tolerance_rad=0.01)
    subject: Any = Visitor(run, config, None, None, place, record, list)  # type: ignore[arg-type]
    point = StablePoint(np.array([0.0, 3.0, 4.0]), 0.0, 1, 1.5, sigma_m=5e-6)
    found = Sample(point, 10.0, 0.75, 1)
    asyncio.run(subject.keep(Visit([0.0] * 6, "smr1", False, []), np.zeros(6), found))
    assert kept[0]["notes"] | {"readings": 1, "window_s": 1.5, "sigma_m": 5e-6} == kept[0]["notes"]
