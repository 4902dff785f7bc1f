"""What is beyond a limit of a tool check fails by its name, and a bent tool is not tried."""

from pathlib import Path

import pytest

from fakes.object import run_virtual
from procedures.laser.judging import judge_check
from tests.kit.laser_cell import (
    laser_cell,
    laser_config,
    states_of_results,
)
from tests.kit.laser_made import T_TOOL, Solved, drawn_reference, solved
from tests.kit.laser_runs import AUTO, JOB
from tests.kit.object_cell import no_report

__all__ = ["no_report", "solved"]

pytestmark = pytest.mark.usefixtures("no_report")


LIMITS = {"max_shift_m": 0.01, "max_tilt_rad": 0.1}
NARROW = {
    "against_reference": {"max_shift_m": 0.001, "max_tilt_rad": 0.1},
    "against_last": {"max_shift_m": 0.01, "max_tilt_rad": 0.005},
    "max_U_m": 0.00005,
    "max_latency_s": 0.02,
}


@pytest.mark.parametrize(
    ("key", "told"),
    [
        (
            "against_reference",
            "bent tool: against_reference.max_shift_m: the point is 1.22 mm off the reference",
        ),
        ("against_last", "bent tool: against_last.max_tilt_rad: the axis is 0.57 deg off the last result"),
        ("max_U_m", "max_U_m: 95 % of the errors stay below 0.1 mm, the limit is 0.05 mm"),
        ("max_latency_s", None),
    ],
)
def test_what_is_beyond_a_limit_fails_by_its_name_and_stays_filled(key: str, told: str | None) -> None:
    answer = Solved(drot=[0.006, 0.008, 0.0], tau=0.05)
    wide = {"against_reference": LIMITS, "against_last": LIMITS, "max_U_m": 0.001, "max_latency_s": 0.1}
    known = {"T_flange_tool_ref": T_TOOL, "T_flange_tool_last": T_TOOL, "offset_s": 0.01}
    assert judge_check(answer.current(), known, wide).verdict == "pass"
    result = judge_check(answer.current(), known, {**wide, key: NARROW[key]}).as_json()
    assert result["result"]["T_flange_tool"][:3] == pytest.approx([0.001, -0.0007, 0.18])
    if told is None:
        assert (result["verdict"], result["reasons"]) == ("warn", [])
        assert "late by 60.0 ms, configured are 10.0 ms" in result["warnings"][0]["text"]
    else:
        assert result["verdict"] == "fail"
        assert result["reasons"][0].startswith(told)


def test_the_last_result_is_another_tool_than_the_reference() -> None:
    known = {"T_flange_tool_ref": T_TOOL, "T_flange_tool_last": [0.002, *T_TOOL[1:]], "offset_s": 0.0}
    wide = {"against_reference": LIMITS, "against_last": LIMITS, "max_U_m": 0.001, "max_latency_s": 0.1}
    result = judge_check(Solved().current(), known, wide).as_json()["result"]
    assert result["against_last"]["shift_m"] == pytest.approx([-0.001, -0.0007, 0.0])
    assert result["against_reference"]["shift_m"] == pytest.approx([0.001, -0.0007, 0.0])


def test_a_bent_tool_is_not_proposed_and_not_tried(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path, update={**AUTO, "against_reference": NARROW["against_reference"]})

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert states_of_results(cell) == []
            assert "second" not in {f.name for f in cell.folder(1).path.iterdir()}

    run_virtual(main())
