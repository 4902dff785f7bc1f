"""The report of a crossed-beam run: figures that agree with exact passes, in mm and degrees."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.tool_frame.scene import ToolFrameScene
from cell.errors import CellError
from cell.formats.laser import parse_laser
from procedures.documents import read_result
from procedures.laser.judging import not_confirmed, why_not
from procedures.laser.moved_words import moved_reasons
from procedures.laser.report.passes import pairs, shown
from procedures.laser.report.source import LaserSource
from procedures.laser.report.tool import crossing, exaggeration, tool_figure
from procedures.laser.result import LaserResult, MovedTest, SecondScan, Update
from procedures.laser.solve.data import scene_of
from procedures.report.write import from_folder, render, write_report
from tests.kit import whole_results
from tests.kit.laser_report_scene import (
    BEAMS,
    DOWN,
    LATENCY_S,
    RADIUS,
    data_set,
    make_run,
    measured,
    reference_document,
)
from tests.kit.solved import solve_laser
from tests.unit.procedures.test_report_page import HOSTILE, Page

SHIFT, TURN = (0.0012, -0.0007, 0.0005), (0.006, 0.008, 0.0)


@pytest.fixture(scope="module")
def data() -> dict[str, Any]:
    return data_set(SHIFT, TURN)


@pytest.fixture(scope="module")
def whole(data: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of an update as it is, plotly.js and all."""
    folder = make_run(tmp_path_factory.mktemp("run"), measured(SHIFT, TURN), data)
    return write_report(folder).read_text("utf-8")


@pytest.fixture(scope="module")
def subject(whole: str) -> Page:
    return Page(whole)


@pytest.fixture
def no_plotly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without the five megabytes of plotly.js, which take long to parse."""
    monkeypatch.setattr("procedures.report.write.plotly_script", lambda: "")


def scene(data: dict[str, Any]) -> ToolFrameScene:
    return scene_of(parse_laser(data, "laser.json"))


def page_of(folder: Path) -> Page:
    return Page(render(from_folder(folder)))


def few(data: dict[str, Any], count: int = 2) -> dict[str, Any]:
    """The first passes of each beam alone: enough for pages whose figures do not matter."""
    less = dict(data)
    for part in ("reference", "current"):
        passes = data[part]["passes"]
        few = [p for b in BEAMS for p in [q for q in passes if q["beam"] == b][:count]]
        less[part] = {**data[part], "passes": few}
    return copy.deepcopy(less)


def test_every_figure_of_a_tool_check_is_drawn(subject: Page) -> None:
    names = {a.get("id") for tag, a in subject.elements if tag == "div"}
    assert {"tool", "edges", "heights", "out-back", "second", "trend", "timeline"} <= names


def test_nothing_in_the_page_asks_the_network(subject: Page) -> None:
    for _, attributes in subject.elements:
        assert not {"src", "href", "action", "data", "srcset"} & attributes.keys()


def test_verdict_numbers_and_tool_come_first(subject: Page) -> None:
    headings = [words for words in subject.words if words.strip()]
    assert "Tool in the crossed beams: pin" in subject.text
    assert headings.index("GO") < headings.index("Pass")  # the first page, then what it rests on
    headings = headings[headings.index("Pass") :]
    order = ["Pass", "1.476 mm", "0.023 mm", "0.5730°", "8.00 ms", "The tool before and now", "Limits"]
    assert [headings.index(words) for words in order] == sorted(headings.index(words) for words in order)


def test_result_is_shown_with_its_interval_in_millimetres_and_degrees(subject: Page) -> None:
    for words in (
        "moved by, mm 1.200 −0.700 0.500",
        "± 95 %, mm 0.018 0.018 0.012",
        "axis turned by, ° 0.3438 0.4584",
    ):
        assert words in subject.text


def test_limits_are_judged_against_reference_and_last(subject: Page) -> None:
    assert "point off the reference, to count as bent 1.476 mm 3.000 mm within" in subject.text
    assert "point off the frame in effect, to count as bent 1.476 mm 1.000 mm beyond" in subject.text
    assert "uncertainty U of the point 0.023 mm 0.200 mm within" in subject.text


def check_of(shift: tuple[float, ...]) -> dict[str, Any]:
    """The document of a check that measured ``shift`` alone, with the test that was made."""
    moved = float(np.linalg.norm(shift)) > 1e-4
    test = {"moved": moved, "shift_m": float(np.linalg.norm(shift)), "U_shift_m": 2.3e-5, "tolerance_m": 1e-4}
    test |= {"tilt_rad": None, "U_tilt_rad": None, "tolerance_rad": None}
    test |= {"false_alarm": 0.01, "detectable_m": 1.3e-4}
    found = measured(shift, None)
    found["inputs"].pop("update")
    found["result"]["moved"] = test
    return found | {"verdict": "fail" if moved else "pass", "reasons": moved_reasons(MovedTest(**test))}


def test_a_check_says_moved_or_not_moved_first_and_what_to_do(
    data: dict[str, Any], tmp_path: Path, no_plotly: None
) -> None:
    (tmp_path / "moved").mkdir()
    moved = page_of(make_run(tmp_path / "moved", check_of(SHIFT), few(data), job="laser-check")).text
    assert (
        "tool moved: the tool's point has moved by 1.48 mm (uncertainty 0.023 mm, tolerance 0.10 mm)" in moved
    )
    assert "cellward start laser-update -p tool=pin." in moved
    assert "point off the frame in effect, to count as moved 1.476 mm 0.100 mm beyond" in moved
    (tmp_path / "good").mkdir()
    good = page_of(make_run(tmp_path / "good", check_of((2e-5, 0.0, 0.0)), few(data), job="laser-check")).text
    assert "The tool has not moved against the frame in effect: its point by 0.02 mm" in good
    assert "cellward start laser-update" not in good
    assert (
        "A tool that has not moved is called moved in 1 of 100 checks at most, one that moved by 0.130 mm in "
        "99 of 100 at least." in good
    )


def test_second_scan_is_held_against_U(subject: Page) -> None:
    assert "meets the reference: it is 0.010 mm off, the limit is 0.033 mm" in subject.text


def test_timeline_tells_unused_passes_and_the_new_version(subject: Page) -> None:
    assert "One pair of passes could not be used." in subject.text
    assert "committed: of T_flange_tool.pin, version 3" in subject.text


def test_deviation_is_drawn_as_many_times_larger_as_it_is_said_to_be(
    data: dict[str, Any], tmp_path: Path, subject: Page
) -> None:
    source = from_folder(make_run(tmp_path, measured(SHIFT, TURN), data))
    assert isinstance(source, LaserSource)
    factor = exaggeration(source)
    assert factor == 20
    # From the front: base x grows with flange x, base z falls with flange z.
    x, z = 1e3 * (crossing(source) + factor * DOWN.apply(SHIFT))[[0, 2]]
    axes = [
        t for t in tool_figure(source, factor).data if t.name == "now, × 20" and t.mode == "lines+markers"
    ]
    now = axes[0]
    assert (now.x[-1], now.y[-1]) == pytest.approx((x, z))
    assert "drawn 20 times as large" in subject.text


def test_small_deviation_is_enlarged_more_and_none_not_at_all(data: dict[str, Any]) -> None:
    tiny = LaserSource(read_result(measured([1e-6, 0.0, 0.0], [0.0] * 3)))
    none = LaserSource(read_result(measured([0.0] * 3, None)))
    for source in (tiny, none):
        source.scene = scene(data)
    assert exaggeration(tiny) == 20000
    assert exaggeration(none) == 1


def test_edges_lie_where_the_cylinder_is(data: dict[str, Any]) -> None:
    found = shown(scene(data), LATENCY_S)
    axis = DOWN.apply([0.0, 0.0, 1.0])
    for beam in BEAMS:
        n = np.cross(axis, np.array(BEAMS[beam]["dir"]))
        n /= np.linalg.norm(n)
        for current in (False, True):
            for k in found.of(beam, current):
                crossing_ = found.seen.crossings.get(k)
                if crossing_ is None:
                    continue
                tilt = np.array(TURN if current else (0.0, 0.0, 0.0))
                moved = np.array(SHIFT if current else (0.0, 0.0, 0.0))
                # Where the moved axis passes the beam's height, seen from the reference's point.
                above = float(np.mean(crossing_.above)) + float(DOWN.apply(moved)[2])
                u = DOWN.apply(np.array([0.0, 0.0, 1.0]) + np.cross(tilt, [0.0, 0.0, 1.0]))
                off = DOWN.apply(moved) + u / u[2] * -above
                low, high = -RADIUS - n @ off, RADIUS - n @ off
                # A poll's time is off by 0.2 ms (4 um of way) beside the interval itself.
                assert np.all(crossing_.low - 2e-5 < [low, high])
                assert np.all(crossing_.high + 2e-5 > [low, high])


def test_estimated_edges_leave_the_residuals_that_the_solver_states(tmp_path: Path, no_plotly: None) -> None:
    (tmp_path / "laser.json").write_text(json.dumps(data_set(SHIFT, TURN, ways=2)))
    result = solve_laser(tmp_path)
    source = LaserSource(read_result(result), tmp_path)
    stated = {(r["set"], r["index"]): r for r in result["residuals"]["per_pass"]}
    assert source.shown is not None
    assert source.estimate is not None
    for k, seen in source.shown.seen.crossings.items():
        row = stated["current" if seen.source.current else "reference", seen.source.index]
        assert row["used"] is (k not in source.shown.unused)
        expected = source.estimate.expected(seen)
        assert expected is not None
        if row["used"]:
            # The height has a say through the tilt alone, and was corrected for the tool's end since.
            assert np.sqrt(np.mean((seen.middle - expected) ** 2)) == pytest.approx(row["rms_m"], abs=1e-6)
    page = Page(render(source))
    assert "edge-residuals" in {a.get("id") for tag, a in page.elements if tag == "div"}
    for words in ("U across the tool", "Held out, RMS", "Not determined: spin about the tool's axis"):
        assert words in page.text


def test_out_and_back_agree_once_the_delay_is_taken_off(data: dict[str, Any]) -> None:
    apart = {}
    for tau in (0.0, LATENCY_S):
        found = shown(scene(data), tau)
        both = [pair for beam in BEAMS for pair in pairs(found, beam, False)]
        middles = [(found.seen.crossings[a], found.seen.crossings[b]) for a, b in both]
        apart[tau] = np.mean([np.sign(a.v[0]) * (a.middle - b.middle).mean() for a, b in middles])
    assert apart[0.0] == pytest.approx(2 * 0.02 * LATENCY_S, abs=3e-5)
    assert apart[LATENCY_S] == pytest.approx(0.0, abs=3e-5)


def test_a_tilt_that_was_not_measured_is_said(data: dict[str, Any], tmp_path: Path, no_plotly: None) -> None:
    page = page_of(make_run(tmp_path, measured(SHIFT, None), few(data)))
    assert "not measured" in page.text
    assert "so the axis is drawn as it was" in page.text


def test_bent_tool_is_painted_red_with_its_figures_and_what_to_do(
    data: dict[str, Any], tmp_path: Path, no_plotly: None
) -> None:
    result = measured(SHIFT, TURN) | {"verdict": "fail", "reasons": ["bent tool: the point is 1.48 mm off"]}
    page = page_of(make_run(tmp_path, result, few(data)))
    assert any(a.get("class") == "verdict fail" for _, a in page.elements)
    assert "bent tool: the point is 1.48 mm off" in page.text
    assert "What to do. Look at the tool" in page.text
    assert "moved by, mm 1.200" in page.text


def test_second_scan_that_missed_is_no_pass_and_says_what_to_do(
    data: dict[str, Any], tmp_path: Path, no_plotly: None
) -> None:
    missed = SecondScan(
        meets=False,
        scans=1,
        false_alarm=1.0 / 300.0,
        apart=4e-4,
        apart_m=[4e-4, 0.0, 0.0],
        U_m=3.3e-5,
        U_point_m=2.3e-5,
        detectable_m=5.5e-5,
    )
    why = why_not(missed, 2e-4)
    found = read_result(measured(SHIFT, TURN))
    assert isinstance(found, LaserResult)
    told = Update(second_scan=missed, committed=False, why=why)
    result = not_confirmed(found.with_inputs(update=told), why).as_json()
    page = page_of(make_run(tmp_path, result, few(data)))
    assert any(a.get("class") == "verdict fail" for _, a in page.elements)
    assert "was not put into effect: second scan" in page.text
    assert "What to do. Nothing was changed." in page.text
    assert "does not meet the reference: it is 0.400 mm off, the limit is 0.033 mm" in page.text
    assert (
        "A right frame is turned down in 1 of 300 updates at most, one that is wrong by 0.055 mm in 99 of "
        "100 at least." in page.text
    )


def test_refused_result_says_why_and_draws_what_there_is(
    data: dict[str, Any], tmp_path: Path, no_plotly: None
) -> None:
    refused = measured(SHIFT, TURN) | {
        "verdict": "fail",
        "reasons": ["one-beam-only: xs alone"],
        "result": None,
    }
    page = page_of(make_run(tmp_path, refused, few(data)))
    assert "Refused: the data cannot determine the answer" in page.text
    assert "one-beam-only: xs alone" in page.text
    assert "edges" in {a.get("id") for tag, a in page.elements if tag == "div"}


def test_reference_shows_its_beams_and_no_displacement(
    data: dict[str, Any], tmp_path: Path, no_plotly: None
) -> None:
    alone = few(data) | {"current": {"passes": []}}
    document = reference_document(alone["reference"]["passes"])
    result = whole_results.whole({"kind": "laser-reference", "verdict": "pass", "result": document})
    page = page_of(make_run(tmp_path, result, alone, job="laser-reference"))
    assert "Crossed-beam reference: pin" in page.text
    assert "height between the beams 0.300 mm 2.000 mm within" in page.text
    assert "moved by" not in page.text
    assert {"tool", "edges"} <= {a.get("id") for tag, a in page.elements if tag == "div"}


def test_result_alone_without_data_says_what_cannot_be_drawn(tmp_path: Path, no_plotly: None) -> None:
    result = measured(SHIFT, TURN)
    result["inputs"]["path"] = str(tmp_path / "laser.json")
    page = Page(write_report(result, tmp_path / "r.html").read_text("utf-8"))
    assert "the tool cannot be drawn" in page.text
    assert "no edges to draw" in page.text
    assert "The data set cannot be read" in page.text
    assert "No limits were set" in page.text


@pytest.mark.parametrize(
    "spoil",
    [
        lambda d: d.update(beams=None),
        lambda d: d.update(tool={"id": 3}),
        lambda d: d.update(R_base_flange="up"),
        lambda d: d["reference"]["passes"][0].pop("poll_v"),
        lambda d: d["current"].update(passes=[]),
        lambda d: d["beams"].update(ys=d["beams"]["xs"]),
    ],
)
def test_damaged_data_set_still_gives_a_report(
    data: dict[str, Any], tmp_path: Path, no_plotly: None, spoil: Callable[[dict[str, Any]], Any]
) -> None:
    broken = few(data)
    folder = make_run(tmp_path, measured(SHIFT, TURN), broken)
    spoil(broken)
    (folder / "laser.json").write_text(json.dumps(broken))
    page = page_of(folder)
    assert "moved by, mm 1.200" in page.text


@pytest.mark.parametrize("key", ["cov", "drot_flange", "against_last", "tau", "latency_s"])
def test_an_answer_without_a_figure_still_gives_a_report(no_plotly: None, key: str) -> None:
    broken = measured(SHIFT, TURN)
    broken["result"][key] = None
    page = Page(render(LaserSource(read_result(broken))))
    assert "Pass" in page.words
    assert "cannot be drawn from this result" not in page.text


def test_text_from_outside_never_becomes_markup(
    data: dict[str, Any], tmp_path: Path, no_plotly: None
) -> None:
    pages = []
    for words in ("harmless", HOSTILE):
        result = measured(SHIFT, TURN)
        result["reasons"] = [words]
        result["inputs"]["trend"] = {f"beams.latency_s.{words}": [[1.7e9, 0.008], [1.7e9 + 60.0, 0.008]]}
        result["inputs"]["update"] = {"committed": False, "why": words}
        spoiled = few(data)
        spoiled["tool"]["id"] = words
        pages.append(page_of(make_run(tmp_path, result, spoiled)))
    harmless, hostile = pages
    assert hostile.count("script") == harmless.count("script")
    assert hostile.count("img") == 0
    assert HOSTILE in hostile.text


def test_a_name_in_a_title_is_no_markup(no_plotly: None, tmp_path: Path) -> None:
    result = whole_results.whole(
        {"kind": "latency", "verdict": "warn", "result": {"source": HOSTILE, "tau": 0.1}}
    )
    page = Page(write_report(result, tmp_path / "r.html").read_text("utf-8"))
    assert f"Delay of '{' '.join(HOSTILE.split())}'" in page.text
    assert "Pass with warnings" in page.text
    assert page.count("img") == 0


def test_a_result_of_an_unknown_kind_gets_no_report_of_another(tmp_path: Path) -> None:
    with pytest.raises(CellError) as caught:
        write_report({"kind": "drift", "verdict": "warn"}, tmp_path / "r.html")
    assert caught.value.name == "KIND_UNKNOWN"
    assert not (tmp_path / "r.html").exists()
