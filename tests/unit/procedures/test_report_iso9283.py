"""The report of a test of accuracy and repeatability, and its words on the command line."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from daemon.words.plan_text import plan_text
from daemon.words.result_text import result_text
from procedures.comparison import compare_results
from procedures.iso9283.report.source import IsoSource
from procedures.report.write import from_folder, from_result, render
from tests.unit.calibration.test_iso9283_figures import data_set, known, solved
from tests.unit.procedures.test_report_page import HOSTILE, Page


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """P3 is 0.8 mm off; arrivals scatter by 0.1 mm at P1 to P5."""
    data = known(data_set({"P3": np.array([0.0, 0.0008, 0.0])}, cycles=12, scatter=1e-4))
    return solved(tmp_path_factory.mktemp("iso"), data, max_AP_m=0.0005)


@pytest.fixture(autouse=True)
def no_plotly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.report.write.plotly_script", lambda: "")


@pytest.fixture
def subject(result: dict[str, Any]) -> Page:
    return Page(render(from_result(result, None)))


def text_of(page: Page) -> str:
    return " ".join(" ".join(page.words).split())


def test_every_figure_is_drawn_and_nothing_asks_the_network(subject: Page) -> None:
    names = {a.get("id") for tag, a in subject.elements if tag == "div"}
    assert {"deviation", "arrivals", "drift"} <= names
    for _, attributes in subject.elements:
        assert not {"src", "href", "action", "data", "srcset"} & attributes.keys()
    assert "cannot be drawn" not in text_of(subject)


def test_each_pose_has_its_figures_beside_the_trackers(subject: Page, result: dict[str, Any]) -> None:
    text = text_of(subject)
    figures = text[text.index("95 % interval") :]
    for pose in result["result"]["poses"]:
        at_most = "" if pose["AP_resolved"] else "≤ "
        AP, own = 1e3 * pose["AP"], 1e3 * pose["AP_tracker"]
        row = figures[figures.index(f"{pose['name']} {at_most}{AP:.3f} mm") :][:200]
        assert f"{1e3 * pose['AP_measured']:.3f} mm" in row
        assert f"{own:.3f} mm" in row
        low, high = pose["RP_95"]
        assert f"{1e3 * low:.3f} … {1e3 * high:.3f}" in row
    for key in ("AP", "RP"):
        assert result["result"]["formula"][key] in text


def test_verdict_and_remedy_name_the_limit(subject: Page) -> None:
    text = text_of(subject)
    assert "max_AP_m: AP is P3 0." in text
    assert "run the test with corrected = true" in text
    assert "attitude accuracy and repeatability" in text


def test_arrivals_are_drawn_about_their_barycentre(result: dict[str, Any]) -> None:
    source = from_result(result, None)
    assert isinstance(source, IsoSource)
    for pose in result["result"]["poses"]:
        cycles, off = source.arrivals(pose["name"])
        assert cycles == list(range(1, 13))
        np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=1e-12)
        distance = np.linalg.norm(off, axis=1)
        assert distance.mean() + 3 * distance.std(ddof=1) == pytest.approx(pose["RP_measured"])


@pytest.mark.parametrize("deviation", [[0.0, 0.0, 0.0], None])
def test_text_is_escaped_and_a_damaged_result_says_so(
    result: dict[str, Any], tmp_path: Path, deviation: list[float] | None
) -> None:
    damaged = copy.deepcopy(result)
    damaged["result"]["poses"][0]["name"] = HOSTILE
    damaged["result"]["poses"][1]["deviation"] = deviation
    (tmp_path / "result.json").write_text(json.dumps(damaged))
    (tmp_path / "run.json").write_text(json.dumps({"run_id": 1, "job": "iso9283"}))
    page = render(from_folder(tmp_path))
    assert "<img src=x" not in page
    assert "<script>alert" not in page
    told = "result.json: result.poses[1].deviation does not fit" in text_of(Page(page))
    assert told is (deviation is None)


def test_the_command_line_says_what_is_resolved_and_what_is_not(result: dict[str, Any]) -> None:
    text = result_text(result)
    assert "iso9283: verdict fail" in text
    assert "12 cycles, the arm commanded by the model of its controller, payload 0.8 kg, 100 % speed" in text
    assert "RP = mean(l) + 3 S_l" in text
    P1 = next(p for p in result["result"]["poses"] if p["name"] == "P1")
    assert f"P1: AP {1e3 * P1['AP']:.3f} mm (the tracker's own; measured" in text
    assert "not measured: attitude accuracy" in text


def test_the_plan_is_told_with_its_order_and_speed() -> None:
    checks = {"joint_rad": 0.5, "joint": "elbow", "workspace_m": 0.2, "floor_m": 0.3, "self_m": 0.1}
    plan = {
        "kind": "iso9283",
        "poses": [{"pose": "P1", "q": [0.0] * 6, "shift_m": 0.0012, "checks": checks}],
        "order": ["P5", "P4", "P3", "P2", "P1"],
        "cycles": 30,
        "arrivals": 154,
        "corrected": True,
        "speed_share": 0.5,
    }
    text = plan_text(plan)
    assert "154 arrivals: 30 cycles of P5, P4, P3, P2, P1 at 50 % of the cell's speed" in text
    assert "by up to 1.200 mm" in text
    assert "28.6 elbow" in text
    assert text.endswith("Nothing was moved.")


def test_two_tests_are_compared_side_by_side(result: dict[str, Any]) -> None:
    better = copy.deepcopy(result)
    better["result"]["corrected"] = True
    for pose in better["result"]["poses"]:
        pose |= {"AP": pose["AP_tracker"], "AP_resolved": False}
    first, *_ = compare_results(result, better).rows()
    poses = [each["result"]["poses"][0] for each in (result, better)]
    assert (first.name, first.of, first.sigma) == ("AP", poses[0]["name"], None)
    assert [first.first, first.second] == [pose["AP"] for pose in poses]
    assert first.difference == pytest.approx(poses[1]["AP"] - poses[0]["AP"])
    text = compare_results(result, better).text("run 1", "run 2")
    assert "run 1 was commanded by the model of its controller, run 2 through its calibrated" in text
    worst = result["result"]["AP_max"]
    own = better["result"]["poses"][2]["AP_tracker"]
    assert f"P3    {1e3 * worst:.3f} mm          at most {1e3 * own:.3f} mm" in text


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"payload_kg": 5.0}, "one test was made with 0.8 kg, the other with 5 kg"),
        ({"speed_share": 0.5}, "speed_share"),
    ],
)
def test_tests_of_another_payload_or_speed_are_not_compared(
    result: dict[str, Any], change: dict[str, Any], told: str
) -> None:
    other = copy.deepcopy(result)
    other["result"] |= change
    with pytest.raises(CellError, match=told):
        compare_results(result, other)
    moved = copy.deepcopy(result)
    moved["result"]["poses"][0]["commanded"][2] += 0.02
    with pytest.raises(CellError, match=r"pose P1 of the tests is 20\.000 mm apart"):
        compare_results(result, moved)
    better = {**result, "reasons": ["solved again"]}
    with pytest.raises(CellError, match="are compared without a test; give no false alarm"):
        compare_results(result, better, false_alarm=0.05)
