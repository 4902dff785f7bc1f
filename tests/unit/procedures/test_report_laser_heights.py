"""The section of a crossed-beam report on the height: every way near the end, and the first contacts."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from cell.formats.laser import parse_laser
from procedures.documents import read_result
from procedures.laser.report.heights import heights_section
from procedures.laser.report.near_end import NearEnd, near_end
from procedures.laser.report.source import LaserSource
from procedures.laser.result import LaserResult
from procedures.laser.solve.data import scene_of
from procedures.report.write import from_folder
from tests.kit.laser_report_scene import BEAMS, LATENCY_S, data_set, make_run, measured
from tests.kit.solved import solve_laser
from tests.unit.procedures.test_report_page import Page

SHIFT = (0.0004, -0.0003, 0.0005)
NEAR = 2e-4  # m over and under the end, of the ways that look for it


@pytest.fixture(scope="module")
def data() -> dict[str, Any]:
    return data_set(SHIFT, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def solved(data: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The answer to ``data``."""
    path = tmp_path_factory.mktemp("data") / "laser.json"
    path.write_text(json.dumps(data), "utf-8")
    return solve_laser(path)


def near(data: dict[str, Any], result: dict[str, Any]) -> NearEnd:
    found = read_result(result)
    assert isinstance(found, LaserResult)
    out = near_end(scene_of(parse_laser(data, "laser.json")), LATENCY_S, (), found)
    assert out is not None
    return out


def with_return(data: dict[str, Any], broken: int) -> dict[str, Any]:
    """With a way back, broken nowhere or as the way out, for each current way just under the end."""
    more = copy.deepcopy(data)
    passes = more["current"]["passes"]
    for beam in BEAMS:
        out = [p for p in passes if p["beam"] == beam][-2]
        later = out["pose_t"][-1] - out["pose_t"][0] + 0.01
        back = {**out, "dir": -1, "pose_xyz": out["pose_xyz"][::-1]}
        back |= {key: [t + later for t in out[key]] for key in ("pose_t", "poll_t")}
        back["poll_v"] = [broken * v for v in out["poll_v"]]
        passes.insert(passes.index(out) + 1, back)
    return more


def test_first_contacts_are_at_the_ends_of_both_tools_within_what_is_stated(
    data: dict[str, Any], solved: dict[str, Any]
) -> None:
    subject = near(data, solved)
    for beam in BEAMS:
        for current, height in ((False, 0.0), (True, SHIFT[2])):
            found, sigma = subject.contacts[beam, current]
            assert 0.0 < sigma < NEAR
            assert abs(found - height) < 3.0 * sigma


def test_every_way_near_the_end_is_a_hit_or_a_miss_at_its_height(
    data: dict[str, Any], solved: dict[str, Any]
) -> None:
    subject = near(data, solved)
    for beam in BEAMS:
        for current, height in ((False, 0.0), (True, SHIFT[2])):
            ways = subject.ways(beam, current)
            assert {word: len(own) for word, own in ways.items()} == {"hit": 1, "miss": 2}
            assert subject.heights[ways["hit"]] == pytest.approx([height - NEAR], abs=1e-5)
            assert sorted(subject.heights[ways["miss"]]) == pytest.approx(
                [height + 1e-5, height + NEAR], abs=1e-5
            )


@pytest.mark.parametrize(
    ("broken", "told"),
    [(0, {"hit, one-sided": 1, "miss, one-sided": 1, "miss": 2}), (1, {"hit": 2, "miss": 2})],
)
def test_a_way_whose_return_shows_no_tool_is_one_sided(
    data: dict[str, Any], solved: dict[str, Any], broken: int, told: dict[str, int]
) -> None:
    subject = near(with_return(data, broken), solved)
    for beam in BEAMS:
        assert {word: len(own) for word, own in subject.ways(beam, True).items()} == told


def test_the_section_tells_contacts_with_their_intervals_and_dashes_where_a_result_has_none(
    data: dict[str, Any], solved: dict[str, Any], tmp_path: Path
) -> None:
    for name, result in (("new", measured(SHIFT, None)), ("old", measured(SHIFT, None))):
        stated = solved["observability"]["heights_m"] if name == "new" else None
        result["observability"]["heights_m"] = stated
        (folder := tmp_path / name).mkdir()
        source = from_folder(make_run(folder, result, data))
        assert isinstance(source, LaserSource)
        section = heights_section(source)
        assert section is not None
        text = Page(str(section)).text
        assert "of them one-sided" in text
        assert ("by the likelihood of all ways" in text) is (name == "new")
        assert ("beam xs, now 1 2 0 –" in text) is (name == "old")
