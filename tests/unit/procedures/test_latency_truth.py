"""What a measured delay is held against: all that lies between the light and what a module shows."""

import json
from pathlib import Path

import pytest

from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.latency.result import LatencyResult
from procedures.latency.truth import judge_delay

STORED = Path(__file__).parents[2] / "kit" / "stored_results" / "latency-04.json"


def measured(offset_s: float) -> LatencyResult:
    """The delay of a beam, to 0.1 ms."""
    result = json.loads(STORED.read_text("utf-8"))
    result["result"] |= {"time_offset_s": offset_s, "interval95_s": [offset_s - 1e-4, offset_s + 1e-4]}
    return LatencyResult.model_validate(result)


@pytest.mark.parametrize(("scenario", "late_s"), [("laser:ideal", 0.002), ("laser", 0.0035)])
def test_a_beam_is_late_by_its_sensor_and_by_the_filter_and_half_the_scan_of_its_module(
    scenario: str, late_s: float, tmp_path: Path
) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"job_config": {"source": "beams", "beam": "xs"}}))
    truth = World.from_scenario(Scenario.load(scenario)).truth()
    assert judge_delay(measured(late_s), truth, tmp_path).inside95
    assert not judge_delay(measured(late_s + 2e-4), truth, tmp_path).good
