"""What a report says on paper: figures that print as vectors, and inputs as a person reads them."""

import json
import re
from pathlib import Path

import pytest

from procedures.report.write import write_report
from procedures.touch_test.words import touch_lines
from tests.kit.whole_results import STORED, made

NEWEST = {path.stem.rpartition("-")[0]: path for path in STORED}.values()  # of each kind


def report_of(folder: Path, stored: Path) -> str:
    (folder / "result.json").write_text(stored.read_text("utf-8"))
    return write_report(folder).read_text("utf-8")


@pytest.mark.parametrize("stored", NEWEST, ids=lambda path: path.stem)
def test_a_figure_in_space_is_left_out_on_paper(stored: Path, tmp_path: Path) -> None:
    """A browser prints it as a picture, or empty: it stands in the section that is not printed."""
    page = report_of(tmp_path, stored)
    sections = re.split(r"(?=<section)", page)
    in_space = [part for part in sections if {"scatter3d", "mesh3d"} & traces(part)]
    assert [part[:40] for part in in_space if not part.startswith('<section class="space"')] == []


def traces(part: str) -> set[str]:
    """The types of what is drawn in a part of a page."""
    drawn = re.findall(r"Plotly\.newPlot\(\s*\"[^\"]+\",\s*(?=\[)", part)
    found = set()
    for call in drawn:
        data, _ = json.JSONDecoder().raw_decode(part[part.index(call) + len(call) :])
        found |= {trace["type"] for trace in data}
    return found


def test_a_stored_result_has_a_figure_in_space(tmp_path: Path) -> None:
    (stored,) = (path for path in STORED if path.stem == "axbc-01")
    assert {"scatter3d", "scatter"} <= traces(report_of(tmp_path, stored))


def test_the_map_of_an_eye_to_hand_check_is_on_paper_in_two_plain_views(tmp_path: Path) -> None:
    (stored,) = (path for path in STORED if path.stem == "axbc-01")
    page = report_of(tmp_path, stored)
    assert 'id="positioning-views"' in page
    assert "from above (x, y)" in page
    assert "RMS" in page[page.index('id="positioning-views"') :]


@pytest.mark.parametrize("kind", ["touch-test-01", "slot-03"])
def test_inputs_are_told_with_their_units_and_without_what_is_not_known(kind: str, tmp_path: Path) -> None:
    (stored,) = (path for path in STORED if path.stem == kind)
    inputs = report_of(tmp_path, stored).partition("<h2>Inputs</h2>")[2]
    assert "<b>arm rms m</b>" not in inputs
    assert "<b>path</b>" not in inputs
    assert "[]" not in inputs
    assert re.search(r"<b>data</b></td><td>[\w-]+\.json</td>", inputs)


@pytest.mark.parametrize(("chance", "says"), [(0.996, "100 %"), (0.42, "42 %"), (0.0123, "1.2 %")])
def test_the_share_of_good_cells_is_a_plain_number(chance: float, says: str) -> None:
    found = made({"kind": "touch-test", "result": {"chance": chance}})
    assert f"shows as much in {says} of tests" in "\n".join(touch_lines(found))
