"""The report as a file: complete, escaped, without network, and honest about what is absent."""

import copy
import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.errors import CellError
from cell.poses import exp_xi, from_pose6, to_pose6
from procedures.documents import read_result
from procedures.hand_eye.report.measured import measure
from procedures.report.figure import LINE, embed, figure
from procedures.report.write import from_result, render, write_report
from tests.kit.solved import solve_hand_eye

X_TRUE = from_pose6([0.01, -0.08, 0.05, 0.03, 0.02, 0.04])
X_OLD = from_pose6([0.01, -0.08, 0.06, 0.03, 0.02, 0.04])
K, SIZE = (900.0, 900.0, 640.0, 360.0), (1280, 720)
COLUMNS, ROWS, SQUARE = 7, 5, 0.03
SOFTWARE = "cellward 0.0.7"
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


def capture(placements: int = 2, poses: int = 8, noise_px: float = 0.05) -> dict[str, Any]:
    """Corners of a chessboard as OpenCV projects them, seen by a camera on an exact arm."""
    rng = np.random.default_rng(7)
    grid = np.array([[i * SQUARE, j * SQUARE, 0.0] for j in range(ROWS) for i in range(COLUMNS)])
    camera = np.array([[K[0], 0, K[2]], [0, K[1], K[3]], [0, 0, 1.0]])
    observations = []
    for k in range(placements * poses):
        group = k // poses
        board = from_pose6([0.6, 0.1 * group, 0.02, 3.1, 0.1 * group, 0.0])
        tilt = 0.4 * np.array([np.sin(2 * np.pi * k / poses), np.cos(2 * np.pi * k / poses), 0.1 * group])
        seen = from_pose6([-0.09 + 0.004 * (k % 3), -0.06, 0.45, *tilt])
        flange = board * seen.inv() * X_TRUE.inv()
        rvec, t = seen.rotation.as_rotvec(), seen.translation
        corners = cv2.projectPoints(grid, rvec, t, camera, None)[0].reshape(-1, 2)
        corners = corners + rng.normal(0.0, noise_px, corners.shape)
        observations.append(
            {
                "index": k,
                "group": group,
                "T_base_flange": to_pose6(flange).tolist(),
                "corners": corners.tolist(),
            }
        )
    return {
        "schema": "cellward.capture/1",
        "setup": "eye-in-hand",
        "camera": {"width": SIZE[0], "height": SIZE[1], "K": list(K), "dist": []},
        "target": {"type": "chessboard", "columns": COLUMNS, "rows": ROWS, "square_m": SQUARE},
        "observations": observations,
    }


class Page(HTMLParser):
    """What a browser would make of the file: elements, and text outside scripts and styles."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self._inside = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = tag

    def handle_data(self, data: str) -> None:
        if self._inside not in ("script", "style"):
            self.words.append(data)

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def count(self, tag: str) -> int:
        return sum(name == tag for name, _ in self.elements)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("set") / "capture.json"
    content = capture()
    content["observations"][3]["corners"] = [None] * (COLUMNS * ROWS)
    path.write_text(json.dumps(content))
    return path


@pytest.fixture(scope="module")
def result(data: Path) -> dict[str, Any]:
    """As far as noise goes: of an exact arm, lens and board."""
    return solve_hand_eye(data, method="ml")


@pytest.fixture
def no_plotly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without the five megabytes of plotly.js, which take long to parse."""
    monkeypatch.setattr("procedures.report.write.plotly_script", lambda: "")


@pytest.fixture
def folder(tmp_path: Path, data: Path, result: dict[str, Any]) -> Path:
    return make_run(tmp_path, data, result)


def make_run(tmp_path: Path, data: Path, result: dict[str, Any]) -> Path:
    """A run folder as it is when the worker draws the report: no end, and a journal that still grows."""
    (tmp_path / "result.json").write_text(json.dumps(result | {"software": SOFTWARE}))
    (tmp_path / "capture.json").write_text(data.read_text())
    run = {
        "run_id": 12,
        "job": "cone-capture",
        "started": "2026-01-02T03:04:05+00:00",
        "config": {"cell": {"name": "bay-3", "twin": True}},
        "identities": {"arm": {"model": "ur10e", "serial": "99991100001"}},
        "job_config": {"accept": {"max_error_t_m": 0.0005, "max_error_r_rad": 0.0005, "auto": False}},
        "values": {
            "payload_kg": 1.2,
            "tool": {"name": "pin", "T_flange_tool": [0.0, 0.0, 0.18, 0.0, 0.0, 0.1], "radius_m": 0.02},
            "calibration": {"eye-in-hand": {"X": to_pose6(X_OLD).tolist()}},
            "configured": {"T_flange_camera": to_pose6(X_OLD).tolist()},
            "versions": {"T_flange_camera": 3},
        },
    }
    (tmp_path / "run.json").write_text(json.dumps(run))
    journal = [
        {"seq": 0, "t": 10.0, "kind": "header", "wall": "2026-01-02T03:04:05+00:00"},
        {"seq": 1, "t": 10.0, "kind": "operator", "event": "start", "who": "anna"},
        {"seq": 2, "t": 10.1, "kind": "state", "state": "plan", "why": ""},
        {"seq": 3, "t": 12.0, "kind": "state", "state": "move", "why": "pose 1"},
        {
            "seq": 4,
            "t": 13.0,
            "kind": "decision",
            "event": "pose skipped",
            "pose": 4,
            "why": "near the pillar",
        },
        {"seq": 5, "t": 14.0, "kind": "operator", "event": "prompt", "prompt": 1, "text": "Move the board."},
    ]
    lines = "".join(json.dumps(line) + "\n" for line in journal)
    (tmp_path / "journal.jsonl").write_text(lines + '{"seq": 6, "t": 15.0, "ki')
    return tmp_path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, data: Path, result: dict[str, Any]) -> str:
    """The report of a run folder as it is, plotly.js and all."""
    return write_report(make_run(tmp_path_factory.mktemp("run"), data, result)).read_text("utf-8")


@pytest.fixture(scope="module")
def subject(whole: str) -> Page:
    """The same as a browser reads it."""
    return Page(whole)


@pytest.mark.usefixtures("no_plotly")
def test_report_of_a_run_is_written_into_its_folder(folder: Path) -> None:
    assert write_report(folder) == folder / "report.html"
    assert [p.name for p in folder.glob("*.html")] == ["report.html"]


@pytest.mark.usefixtures("no_plotly")
def test_report_goes_where_it_is_sent(folder: Path, tmp_path: Path) -> None:
    assert write_report(folder, tmp_path / "there.html").read_text("utf-8").startswith("<!DOCTYPE html>")
    assert not (folder / "report.html").exists()


def test_nothing_in_the_page_asks_the_network(subject: Page) -> None:
    for _, attributes in subject.elements:
        assert not {"src", "href", "action", "data", "srcset"} & attributes.keys()
    policies = [a["content"] for tag, a in subject.elements if tag == "meta" and "http-equiv" in a]
    assert policies
    assert policies[0] is not None
    assert policies[0].startswith("default-src 'none'")


def test_plotly_is_inside_once(whole: str) -> None:
    assert whole.count("plotly.js v") == 1


def test_every_figure_of_a_run_is_drawn(subject: Page) -> None:
    names = {a.get("id") for tag, a in subject.elements if tag == "div"}
    assert {"scene", "views", "before-after", "residuals", "timeline"} <= names


def test_verdict_comes_first_and_names_the_frames(subject: Page) -> None:
    headings = [words for words in subject.words if words.strip()]
    assert "Hand-eye calibration: camera in flange" in subject.text
    assert headings.index("Pass") < headings.index("The result: camera in flange")
    assert "residuals are not accuracy" in subject.text.lower()


def test_result_is_shown_in_millimetres_and_degrees(subject: Page, result: dict[str, Any]) -> None:
    pose = np.array(result["result"]["T_flange_camera"])
    for shown in [*(f"{1e3 * v:.3f}" for v in pose[:3]), *(f"{np.degrees(v):.4f}" for v in pose[3:])]:
        assert shown.replace("-", "−") in subject.text


def test_interval_is_turned_into_the_frame_of_the_result(subject: Page, result: dict[str, Any]) -> None:
    cov = np.array(result["result"]["cov"])[:3, :3]
    R = Rotation.from_rotvec(result["result"]["T_flange_camera"][3:]).as_matrix()
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(3), cov * 1e6, 400_000) @ R.T
    shown = subject.words[subject.words.index("± 95 %, mm") + 1 :][:3]
    assert [float(v) for v in shown] == pytest.approx(1.96 * draws.std(axis=0), abs=6e-4)


def test_pose_before_is_named_and_its_distance_told(subject: Page, result: dict[str, Any]) -> None:
    away = 1e3 * np.linalg.norm(np.array(result["result"]["T_flange_camera"])[:3] - X_OLD.translation)
    assert f"lies {away:.3f} mm" in subject.text
    assert "from version 3 that was in effect" in subject.text


def test_observation_without_target_is_listed_with_its_reason(subject: Page) -> None:
    assert "Observations that were not used number why 3 the target was not found" in subject.text


def test_timeline_tells_prompts_and_skipped_poses(subject: Page) -> None:
    assert "pose skipped: near the pillar, pose 4" in subject.text
    assert "prompt: Move the board." in subject.text
    assert "1 times pose skipped" in subject.text
    assert "drawn before the run had ended" not in subject.text, "that is so for every report of a result"


def test_inputs_name_cell_device_and_payload(subject: Page) -> None:
    for words in (
        "bay-3",
        "serial 99991100001",
        "1.2 kg",
        "T_flange_tool (0.000 0.000 180.000 mm, rotation vector 0.0000 0.0000 5.7296 deg)",
        "T_flange_camera version 3",
        "simulated cell",
        SOFTWARE,
    ):
        assert words in subject.text


def test_a_simulated_cell_is_told_first_in_the_title_and_across_each_printed_page(
    subject: Page, whole: str
) -> None:
    assert "<title>TWIN: " in whole
    told = "Simulated cell (twin): nothing in this report was measured on real devices."
    assert subject.text.index(told) < subject.text.index("GO")
    assert any(a.get("class") == "watermark" for _, a in subject.elements)


def test_limits_are_judged_with_the_interval(subject: Page) -> None:
    assert subject.text.count("within") >= 2
    assert "0.500 mm within" in subject.text


@pytest.mark.usefixtures("no_plotly")
def test_run_that_ended_badly_is_not_painted_green(folder: Path) -> None:
    (folder / "end.json").write_text(json.dumps({"outcome": "aborted"}))
    page = Page(write_report(folder).read_text("utf-8"))
    assert "Pass (but the run ended aborted)" in page.text
    assert any(a.get("class") == "verdict warn" for _, a in page.elements)


@pytest.mark.usefixtures("no_plotly")
def test_text_from_outside_never_becomes_markup(folder: Path, subject: Page) -> None:
    result = json.loads((folder / "result.json").read_text())
    result["reasons"] = [HOSTILE]
    result["warnings"] = [{"code": HOSTILE, "text": HOSTILE + "!"}]
    result["result"]["rejected"] = [{"index": k, "reason": HOSTILE} for k in range(4)]
    result["residuals"]["per_observation"][0] |= {"used": False}
    result["observability"]["weakest"] = HOSTILE
    result["inputs"][HOSTILE] = HOSTILE
    (folder / "result.json").write_text(json.dumps(result))
    run = json.loads((folder / "run.json").read_text())
    run["config"]["cell"]["name"], run["identities"] = HOSTILE, {HOSTILE: {HOSTILE: HOSTILE}}
    (folder / "run.json").write_text(json.dumps(run))
    lines = [{"t": k, "kind": "state", "state": HOSTILE + str(k), "why": HOSTILE} for k in range(3)]
    lines.append({"t": 4, "kind": "error", "text": HOSTILE})
    (folder / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    page = Page(write_report(folder).read_text("utf-8"))
    assert page.count("script") == subject.count("script")
    assert page.count("img") == 0
    assert HOSTILE in page.text


@pytest.mark.usefixtures("no_plotly")
@pytest.mark.parametrize("key", ["spread_within", "estimates", "noise", "rejected"])
def test_a_result_that_does_not_fit_its_kind_is_shown_as_plain_figures_and_names_the_field(
    result: dict[str, Any], key: str
) -> None:
    broken = copy.deepcopy(result)
    broken["result"][key] = "junk"
    page = Page(render(from_result(broken, None)))
    assert "Pass" in page.words
    assert "Shown as plain figures: " in page.text
    assert f"result.{key} does not fit" in page.text
    assert "T_flange_camera" in page.text


@pytest.mark.parametrize("key", ["residuals", "heldout", "observability", "inputs", "warnings"])
def test_a_result_with_a_table_that_is_none_is_refused_by_its_name(result: dict[str, Any], key: str) -> None:
    with pytest.raises(CellError, match=f"{key} does not fit") as caught:
        from_result({**result, key: "junk"}, None)
    assert caught.value.name == "RESULT_INVALID"


@pytest.mark.usefixtures("no_plotly")
@pytest.mark.parametrize("floor", [None, 0.0])
def test_a_spread_without_a_floor_is_neither_resolved_nor_not(
    result: dict[str, Any], floor: float | None
) -> None:
    bare = copy.deepcopy(result)
    for name in ("spread_within", "spread_across"):
        told = None if floor is None else True
        bare["result"][name] |= {"floor_t": floor, "floor_r": floor, "resolved": told}
    page = Page(render(from_result(bare, None)))
    assert page.text.count("what noise alone gives is not known: ") == 2
    assert not {"resolved", "not resolved"} & set(page.words)


@pytest.mark.usefixtures("no_plotly")
def test_absent_figures_are_said_to_be_absent(result: dict[str, Any]) -> None:
    bare = copy.deepcopy(result)
    bare["result"]["cov"], bare["residuals"]["cross_check"] = None, {}
    bare["uncertainty"] = {"meaning": "this method gives none"}
    page = Page(render(from_result(bare, None)))
    for words in (
        "gave no covariance",
        "no cross-check",
        "nothing to compare with",
        "poses cannot be drawn",
    ):
        assert words in page.text


@pytest.mark.usefixtures("no_plotly")
def test_unreadable_data_set_is_named(result: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "capture.json").write_text("{")
    page = Page(render(from_result(result, tmp_path)))
    assert "The data set cannot be read" in page.text
    assert str(tmp_path / "capture.json") in page.text


@pytest.mark.usefixtures("no_plotly")
def test_refused_result_says_why_and_what_to_do(tmp_path: Path) -> None:
    content = capture(placements=1)
    for observation in content["observations"]:
        observation["T_base_flange"] = [0.1 * observation["index"], 0.0, 0.5, 0.0, 0.0, 0.0]
    (tmp_path / "capture.json").write_text(json.dumps(content))
    result = solve_hand_eye(tmp_path)
    page = Page(write_report(result, tmp_path / "r.html", data=tmp_path).read_text("utf-8"))
    assert result["result"] is None
    assert "Refused: the data cannot determine the answer" in page.text
    assert "no-rotation" in page.text
    assert "What to do. Turn the flange between poses" in page.text
    assert "Axes of the flange at each pose" in page.text


@pytest.mark.usefixtures("no_plotly")
def test_the_report_says_where_the_uncertainty_comes_from(data: Path, tmp_path: Path) -> None:
    subject = Page(write_report(make_run(tmp_path, data, solve_hand_eye(data))).read_text("utf-8"))
    assert "Where the uncertainty comes from" in subject.text
    for known in ("office printer", "its maker has calibrated", "neighbouring poses share"):
        assert known in subject.text
    assert "Covered: noise, arm, lens, target" in subject.text
    assert "Printed size along x" in subject.text


@pytest.mark.usefixtures("no_plotly")
def test_a_report_of_noise_alone_says_so(folder: Path) -> None:
    subject = Page(write_report(folder).read_text("utf-8"))
    assert "Covered: noise alone; arm, lens and target are taken as exact" in subject.text


def test_result_without_a_path_is_refused(result: dict[str, Any]) -> None:
    with pytest.raises(CellError, match="needs a path"):
        write_report(result)


def test_folder_without_a_result_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CellError, match=r"result\.json"):
        write_report(tmp_path)


def test_poses_measured_again_put_the_target_where_it_was(data: Path, result: dict[str, Any]) -> None:
    found = measure(data, read_result(result).result)
    poses = found.target_poses(np.asarray(X_TRUE.as_matrix()))
    assert not found.seen[3]
    for k in np.flatnonzero(found.seen):
        truth = from_pose6([0.6, 0.1 * found.group[k], 0.02, 3.1, 0.1 * found.group[k], 0.0])
        assert np.linalg.norm(poses[k, :3, 3] - truth.translation) < 3e-4


def test_wrong_pose_scatters_the_target_as_geometry_says(tmp_path: Path) -> None:
    content = capture(placements=1, noise_px=0.0)
    (tmp_path / "capture.json").write_text(json.dumps(content))
    found = measure(tmp_path, read_result(solve_hand_eye(tmp_path)).result)
    step = exp_xi([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
    poses = found.target_poses(np.asarray((X_TRUE * step).as_matrix()))
    axes = [
        (from_pose6(o["T_base_flange"]) * X_TRUE).rotation.apply([0, 0, 1]) for o in content["observations"]
    ]
    assert poses[:, :3, 3] - np.array([0.6, 0.0, 0.02]) == pytest.approx(0.01 * np.array(axes), abs=2e-6)


def test_fonts_margins_and_axes_come_with_the_look_and_are_not_set_in_each_figure() -> None:
    subject = figure(300)
    assert subject.to_dict()["layout"].keys() == {"height"}
    look = str(embed(subject, "place")).partition('"template"')[2]
    assert all(part in look for part in ("Segoe UI", '"margin":{"l":60', f'"gridcolor":"{LINE}"'))
