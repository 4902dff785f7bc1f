"""The command line about crossed-beam jobs: results, versions and plans in readable words."""

import json
from typing import Any

import pytest

from cell.store.ledger import Ledger
from daemon.words.plan_text import plan_text
from procedures.comparison import compare_results
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.whole_results import whole

REFERENCE: dict[str, Any] = {
    "schema": "cellward.laser-reference/1",
    "tool": {"id": "pin", "p_ref": [0.0, 0.0, 0.18], "axis_ref": [0.0, 0.0, 1.0], "radius": 0.003},
    "R_base_flange": [3.14159265, 0.0, 0.0],
    "beams": {
        "xs": {"point": [0.5, 0.1, 0.2], "dir": [1.0, 0.0, 0.0]},
        "ys": {"point": [0.52, 0.08, 0.2], "dir": [0.02, 0.9998, 0.0]},
    },
    "hits": {"xs": [0.5, 0.1, 0.38], "ys": [0.52, 0.08, 0.38]},
    "passes": [{"beam": "xs", "pose_t": list(range(1000))}] * 32,
    "tau_s": 0.0081,
    "plane": {"gap_m": -0.0003, "slope_rad": {"xs": 0.0, "ys": -0.001}},
}


def laser_result(x_mm: float = 1.2, tool: str = "pin", **parts: Any) -> dict[str, Any]:
    """A measured tool with 0.01 mm and 0.2 mrad; nothing is known of its spin."""
    cov = [[0.0] * 6 for _ in range(6)]
    for i in range(3):
        cov[i][i] = 1e-10
    for i in (3, 4):
        cov[i][i] = 4e-8
    cov[5][5] = 1e-16  # what rounding leaves of it
    answer = {
        "dp_flange": [1e-3 * x_mm, -0.0007, 0.0005],
        "drot_flange": [0.006, 0.008, 0.0],
        "cov": cov,
        "latency_s": 0.0081,
        "hysteresis_m": 0.00005,
        "T_flange_tool": [0.0012, -0.0007, 0.1805, 0.006, 0.008, 0.0],
        "against_last": {"shift_m": [0.0, 0.0, 0.0], "shift": 0.0002, "tilt_rad": 0.001},
    }
    named = {
        "schema": "cellward.result/1",
        "kind": "laser",
        "verdict": "pass",
        "reasons": [],
        "warnings": [],
        "result": answer,
        "uncertainty": {"U_point_m": 0.000031},
        "residuals": {},
        "heldout": {},
        "observability": {},
        "inputs": {"tool": tool},
    }
    return whole(named | parts)


def test_show_tells_a_measured_tool_in_millimetres_and_degrees(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    cell.add_run(1, laser_result(), outcome="complete", verdict="pass")
    shown = subject("show", 1).out
    for told in (
        "laser: verdict pass",
        "1.476 mm from where the reference has it",
        "[1.2000, -0.7000, 0.5000] mm, standard uncertainty 0.0100, 0.0100, 0.0100 mm",
        "tilted by 0.5730 deg",
        "U = 0.031 mm",
        "against the tool frame in effect 0.200 mm, 0.0573 deg",
        "late by 8.10 ms",
    ):
        assert told in shown


def test_show_says_why_a_tool_is_bent_and_that_tilt_was_not_measured(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    result = laser_result(verdict="fail", reasons=["bent tool: the point is 4.00 mm off the reference"])
    result["result"] |= {"drot_flange": None, "cov": None}
    cell.add_run(1, result, outcome="complete", verdict="fail")
    shown = subject("show", 1).out
    for told in (
        "verdict fail",
        "because: bent tool: the point",
        "tilt was not measured",
        "without uncertainty",
    ):
        assert told in shown


def test_uncertainty_comes_from_the_covariance_where_no_job_stated_it(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    cell.add_run(1, laser_result(uncertainty={}), outcome="complete")
    # Three equal axes: the root of chi-square's 95 % point with three degrees of freedom is 2.795.
    assert "U = 0.028 mm" in subject("show", 1).out


@pytest.mark.parametrize(
    ("update", "told"),
    [
        (
            {"second_scan": {"apart": 0.00001, "U_m": 0.00003, "meets": True}, "committed": True},
            "second scan: the point is 0.010 mm off the reference, within the limit of 0.030 mm",
        ),
        (
            {
                "second_scan": {
                    "apart": 1e-5,
                    "U_m": 3e-5,
                    "meets": True,
                    "false_alarm": 0.01,
                    "detectable_m": 5e-5,
                },
            },
            "a right frame is turned down in 1 of 100 updates at most, one that is wrong by 0.050 mm in 99 "
            "of 100 at least",
        ),
        (
            {
                "second_scan": {"apart": 0.0004, "U_m": 0.00003, "meets": False},
                "committed": False,
                "why": "far",
            },
            "the new frame was not put into effect: far",
        ),
        (
            {"committed": False, "why": "far", "controller_tool": "candidate"},
            "may still hold the TCP that was tried; the next job sets the one in effect before it moves",
        ),
        ({"committed": True, "accepted_by": "policy"}, "in effect from the next job on, accepted by policy"),
        ({"committed": False, "why": "finished by the operator"}, "finished by the operator"),
    ],
)
def test_show_tells_what_became_of_an_update(
    cell: CellOnDisk, subject: CommandLine, update: dict[str, Any], told: str
) -> None:
    cell.add_run(1, laser_result(inputs={"update": update}), outcome="complete")
    assert told in subject("show", 1).out


def test_show_tells_a_reference_without_its_passes(cell: CellOnDisk, subject: CommandLine) -> None:
    result = laser_result(kind="laser-reference", result=REFERENCE)
    cell.add_run(1, result, outcome="complete", verdict="pass")
    shown = subject("show", 1).out
    assert "beam xs through [500.0000, 100.0000, 200.0000] mm" in shown
    assert "beam ys rises by 0.057 deg" in shown
    assert "flange at [520.0000, 80.0000, 380.0000] mm" in shown
    assert len(shown) < 3000


def test_show_tells_a_delay_with_its_interval(cell: CellOnDisk, subject: CommandLine) -> None:
    answer = {
        "source": "beams",
        "time_offset_s": 0.0081,
        "interval95_s": [0.0079, 0.0083],
        "tau": 0.0081,
        "applied_s": 0.0,
        "hysteresis_m": None,
    }
    cell.add_run(1, laser_result(kind="latency", result=answer), outcome="complete", verdict="pass")
    shown = subject("show", 1).out
    assert "the stamps of 'beams' are late by 8.10 ms, 95 % interval 7.90 ms to 8.30 ms" in shown
    assert "its driver takes off 0.00 ms" in shown


def test_a_refused_measurement_has_no_answer_and_says_why(cell: CellOnDisk, subject: CommandLine) -> None:
    refused = laser_result(verdict="fail", result=None, reasons=["one-beam: nothing crossed ys"])
    cell.add_run(1, refused, outcome="complete", verdict="fail")
    shown = subject("show", 1).out
    assert "one-beam: nothing crossed ys" in shown
    assert "the data cannot determine it" in shown


def test_results_shows_a_tool_frame_and_a_summary_of_a_reference(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    cell.state.mkdir()
    ledger = Ledger(cell.state / "ledger.sqlite")
    ledger.propose("laser_reference.pin", REFERENCE, {}, 1, None)
    ledger.propose("T_flange_tool.pin", [0.0012, -0.0007, 0.1805, 0.0, 0.0, 0.0], {}, 2, [0.0] * 6)
    ledger.propose("time_offset_s.beams", 0.0081, {}, 3, 0.0)
    ledger.close()
    shown = subject("results").out
    assert "[1.200, -0.700, 180.500] mm" in shown
    assert "tool pin, flange at the beams xs [500.000, 100.000, 380.000] mm" in shown
    assert "32 passes" in shown
    assert "8.10 ms" in shown
    assert len(shown) < 2000


def test_results_as_json_keep_documents_for_who_asks_for_one(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.state.mkdir()
    ledger = Ledger(cell.state / "ledger.sqlite")
    number = ledger.propose("laser_reference.pin", REFERENCE, {"verdict": "pass"}, 1, None)
    ledger.propose("T_flange_tool.pin", [0.0012, -0.0007, 0.1805, 0.0, 0.0, 0.0], {}, 2, [0.0] * 6)
    ledger.close()
    listed = subject("results", "--json").out
    assert len(listed) < 2000
    tool, reference = json.loads(listed)
    assert tool["value"][:2] == [0.0012, -0.0007]
    assert reference["value"]["schema"] == REFERENCE["schema"]
    assert "32 passes" in reference["value"]["summary"]
    for which in ("laser_reference.pin", number):
        (entry,) = json.loads(subject("results", which, "--json").out)
        assert entry["value"] == REFERENCE
    assert "32 passes" in subject("results", number).out
    unknown = subject("results", 99)
    assert unknown.code == 2
    assert "99" in unknown.err


def test_compare_weighs_the_displacements_of_two_checks(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.add_run(1, laser_result(), outcome="complete")
    cell.add_run(2, laser_result(x_mm=1.3), outcome="complete")
    cell.add_run(3, laser_result(x_mm=1.205), outcome="complete")
    far, near = (json.loads(subject("compare", 1, other, "--json").out) for other in (2, 3))
    # 0.1 mm against sqrt(2) * 0.01 mm; the spin about the tool's axis is in neither.
    assert far["m2"] == pytest.approx(0.1**2 / (2 * 0.01**2))
    assert far["degrees_of_freedom"] == 5
    assert (far["significant"], near["significant"]) == (True, False)
    assert "(in the flange)" in subject("compare", 1, 2).out
    rows = {row.name: row for row in compare_results(laser_result(), laser_result(x_mm=1.3)).rows()}
    assert (rows["x"].first, rows["x"].second) == (pytest.approx(1.2e-3), pytest.approx(1.3e-3))
    assert rows["x"].difference == pytest.approx(1e-4)
    assert rows["x"].sigma == pytest.approx(2**0.5 * 1e-5)
    assert rows["about_x"].first is None  # the turn alone has a meaning


def test_what_one_good_tool_of_twenty_shows_by_chance_is_no_difference(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    cell.add_run(1, laser_result(), outcome="complete")
    cell.add_run(2, laser_result(x_mm=1.252), outcome="complete")
    found = json.loads(subject("compare", 1, 2, "--json").out)
    assert found["p"] < 0.05
    assert (found["significant"], found["false_alarm"]) == (False, pytest.approx(1.0 / 300.0))
    cell.add_run(3, laser_result(x_mm=1.2 + 1e3 * found["detectable_m"]), outcome="complete")
    assert json.loads(subject("compare", 1, 3, "--json").out)["significant"]
    assert "1 of 300" in subject("compare", 1, 3).out


def test_compare_without_tilt_uses_the_point_alone(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.add_run(1, laser_result(), outcome="complete")
    flat = laser_result(x_mm=1.3)
    flat["result"]["drot_flange"] = None
    cell.add_run(2, flat, outcome="complete")
    assert json.loads(subject("compare", 1, 2, "--json").out)["degrees_of_freedom"] == 3


def test_compare_refuses_two_tools_and_two_kinds(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.add_run(1, laser_result(), outcome="complete")
    cell.add_run(2, laser_result(tool="probe"), outcome="complete")
    cell.add_run(3, laser_result(kind="laser-reference", result=REFERENCE), outcome="complete")
    assert "'probe'" in (done := subject("compare", 1, 2)).err
    assert done.code == 2
    assert "a laser-reference result" in subject("compare", 1, 3).err
    assert subject("compare", 3, 3).code == 2


def test_a_plan_of_sweeps_is_listed_with_its_margins_and_problems() -> None:
    checks = {"joint": "wrist 2", "joint_rad": 0.5, "clearance": "table", "clearance_m": 0.012}
    margins = {"workspace_m": 0.1, "floor_m": 0.03, "self_m": 0.2, "singularity": 0.5}
    row = {
        "index": "xs 1 at 5.0 mm",
        "from": [0.4, 0.1, 0.2],
        "to": [0.45, 0.1, 0.2],
        "checks": checks | margins,
        "problem": "below the floor",
        "sweeps": 12,
    }
    approach = {"index": "xs approach", "checks": {}, "problem": None, "sweeps": 0, "q": [0.0] * 6}
    plan = {
        "kind": "laser",
        "sweeps": [approach, row],
        "note": "12 sweeps at most",
        "floor_m": 0.15,
        "problems": ["xs 1 at 5.0 mm: below the floor"],
    }
    shown = plan_text(plan)
    for told in (
        "12 sweeps at most",
        "450.0 100.0 200.0",
        "12 table",
        "28.6 wrist 2",
        "does not go below 150.0 mm",
        "not possible: xs 1 at 5.0 mm: below the floor",
        "Nothing was moved.",
    ):
        assert told in shown
