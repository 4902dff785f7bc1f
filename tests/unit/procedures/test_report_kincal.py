"""The report of a kinematic calibration: every figure in it agrees with the result and with the arm."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import stdtrit

from calibration.identification.solution import identify
from calibration.identification.workspace import forecast
from procedures.report.write import from_folder, from_result, render, write_report
from procedures.tracker.report.source import KincalSource, kind_of
from tests.kit.kincal_scene import Scene, make_scene
from tests.kit.solved import solve_kincal
from tests.unit.procedures.test_report_page import HOSTILE, Page


@pytest.fixture(scope="module", params=["ur10e", "palletizer"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def scene(kind: str) -> Scene:
    return make_scene(kind, 3, 60, blunders=2)


@pytest.fixture(scope="module")
def path(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scene.write(tmp_path_factory.mktemp("set"))


@pytest.fixture(scope="module")
def result(path: Path) -> dict[str, Any]:
    return solve_kincal(path)


@pytest.fixture(autouse=True)
def no_plotly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.report.write.plotly_script", lambda: "")


@pytest.fixture(scope="module")
def source(result: dict[str, Any], path: Path) -> KincalSource:
    found = from_result(result, path)
    assert isinstance(found, KincalSource)
    return found


@pytest.fixture(scope="module")
def subject(source: KincalSource) -> Page:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("procedures.report.write.plotly_script", lambda: "")
        return Page(render(source))


def text_of(page: Page) -> str:
    return " ".join(" ".join(page.words).split())


def test_every_figure_is_drawn_and_nothing_asks_the_network(subject: Page) -> None:
    names = {a.get("id") for tag, a in subject.elements if tag == "div"}
    assert {"before-after", "map", "space", "residuals"} <= names
    for _, attributes in subject.elements:
        assert not {"src", "href", "action", "data", "srcset"} & attributes.keys()
    assert "cannot be drawn" not in text_of(subject)


def test_three_figures_stand_beside_the_trackers_uncertainty(subject: Page, result: dict[str, Any]) -> None:
    text, answer, held = text_of(subject), result["result"], result["heldout"]
    tracker = result["uncertainty"]["tracker"]
    own = f"{1e3 * tracker['sigma_axis']:.3f} mm {1e3 * tracker['sigma_3d']:.3f} mm"
    for name, words in (
        ("nominal", "nominal"),
        ("registration_only", "registration only"),
        ("calibrated", "calibrated"),
    ):
        rms, largest = answer[f"rms_{name}"], held["max"][name]
        assert f"{words} {1e3 * rms:.3f} mm {1e3 * largest:.3f} mm {own}" in text
    assert tracker["sigma_3d"] == pytest.approx(np.sqrt(3.0) * tracker["sigma_axis"])


def test_rank_and_combinations_are_told_in_words(subject: Page, result: dict[str, Any]) -> None:
    text = text_of(subject)
    assert f"Rank {result['result']['rank']} of {len(result['result']['parameters'])}" in text
    assert result["result"]["unidentifiable"]
    assert all(words in text for words in result["result"]["unidentifiable"])


def test_parameters_are_listed_with_their_interval_and_open_ones_have_none(
    subject: Page, result: dict[str, Any]
) -> None:
    text, answer = text_of(subject), result["result"]
    k95 = stdtrit(result["uncertainty"]["degrees_of_freedom"], 0.975)  # Student's
    assert k95 > 1.96
    for name, sigma in answer["sigma"].items():
        scale = {"length": 1e3, "angle": 1e3, "ratio": 1.0}[kind_of(name)]
        digits = 6 if kind_of(name) == "ratio" else 4
        shown = "open" if sigma is None else f"{k95 * scale * sigma:.{digits}f}"
        row = text[text.index(f" {name} ", text.index("nominal calibrated change")) :][:90]
        assert f" {shown} " in row


def test_kinds_of_parameters_agree_with_the_model(source: KincalSource) -> None:
    assert source.model is not None
    assert [kind_of(name) for name in source.model.names] == list(source.model.kinds)


def test_rejected_samples_are_listed_with_their_reasons(subject: Page, scene: Scene) -> None:
    text = text_of(subject)
    for index in scene.blunders:
        assert f" {index} disagrees with the others by" in text


def test_rule_of_thumb_is_told_with_its_verdict_and_in_words_that_anybody_knows(subject: Page) -> None:
    assert "not kept 60 poses, smallest step" in text_of(subject)
    assert "A rule of thumb for poses" in text_of(subject)
    assert "source's rule" not in text_of(subject).lower()


def test_four_maps_side_by_side_keep_their_width_on_a_phone(subject: Page) -> None:
    (at,) = (k for k, (_, a) in enumerate(subject.elements) if a.get("id") == "map")
    assert "figure wide" in [a.get("class") for _, a in subject.elements[at - 2 : at]]


def test_poses_are_drawn_where_the_reflector_truly_was(source: KincalSource, scene: Scene) -> None:
    """To a few millimetres: the gauge of the tracker's place and the base is the arm's drawing."""
    T, measured = source.T_base_tracker, source.measured
    assert T is not None
    assert measured is not None
    assert source.frames is not None
    used = [k for k, index in enumerate(measured.index) if index not in scene.blunders]
    at = measured.p_tracker @ T[:3, :3].T + T[:3, 3]
    points = [scene.truth.flange(q) @ [*scene.truth.tools["smr1"], 1.0] for q in measured.Q]
    assert np.abs(at - np.array(points)[:, :3])[used].max() < 0.02
    flange = np.array([scene.truth.flange(q)[:3, 3] for q in measured.Q])
    assert np.abs(source.frames[:, -1] - flange).max() < 0.02


def test_map_has_the_errors_that_the_solution_predicts(source: KincalSource, scene: Scene) -> None:
    at = source.forecast_at(scene.Q)
    own = forecast(identify(scene.problem, {}), scene.Q)
    assert at is not None
    assert source.forecast is not None
    np.testing.assert_allclose(at.error95, own.error95, rtol=1e-5)
    np.testing.assert_allclose(at.p, own.p, atol=5e-4)  # predicted, not as the tracker read it
    assert len(source.forecast.p) == 8000


def test_without_its_data_set_the_page_says_what_is_absent(result: dict[str, Any]) -> None:
    text = text_of(Page(render(from_result(result, None))))
    assert "No data set is at hand, so the poses cannot be drawn." in text
    assert "200 joint vectors spread" in text


def test_a_refusal_names_what_is_lacking_and_what_to_do(scene: Scene, tmp_path: Path) -> None:
    few = scene.changed(samples=scene.data["samples"][:6])
    path = few.write(tmp_path)
    text = text_of(Page(render(from_result(solve_kincal(path), path))))
    assert "Refused: the data cannot determine the answer" in text
    assert "too-few-poses" in text
    assert "Measure more poses" in text


def test_the_classic_method_shows_no_uncertainty_that_it_lacks(path: Path) -> None:
    text = text_of(Page(render(from_result(solve_kincal(path, method="classic"), path))))
    assert "no error can be predicted" in text
    assert "it gives no uncertainty" in text


def test_text_of_the_data_is_escaped(scene: Scene, tmp_path: Path) -> None:
    data = copy.deepcopy(scene.data)
    for sample in data["samples"]:
        sample["target"] = HOSTILE
    data["robot"]["tool"] = {**data["robot"].get("tool", {}), HOSTILE: [0.1, 0.05, -0.1]}
    path = tmp_path / "kincal.json"
    path.write_text(json.dumps(data))
    page = write_report(solve_kincal(path), tmp_path / "r.html", data=path).read_text("utf-8")
    assert "<img src=x" not in page
    assert "<script>alert" not in page


def test_a_result_without_predictions_has_its_other_sections(result: dict[str, Any], path: Path) -> None:
    less = copy.deepcopy(result)
    less["uncertainty"]["predicted_95"] = None
    text = text_of(Page(render(from_result(less, path))))
    assert "Held-out check" in text
    assert "The poses in space" in text
    assert "cannot be drawn from this result" not in text


# -- what only a run has


def a_run(folder: Path, path: Path, result: dict[str, Any], looks: int = 3) -> Path:
    """A run folder as a sampling leaves it, with monuments that were looked at ``looks`` times."""
    moved = {"m1": {"shift_m": [2e-5, 0, 0], "moved_m": 2e-5, "sigma_m": 4e-5},
             "<m2>": {"shift_m": [0, 7.5e-5, 0], "moved_m": 7.5e-5, "sigma_m": 4e-5}}  # fmt: skip
    monuments = {
        "limit_m": 1e-4,
        "names": sorted(moved),
        "looks": [{"after": 10 * k, "t": 100.0 * k, "moved": moved} for k in range(1, looks)],
        "max_moved_m": 7.5e-5 if looks > 1 else 0.0,
        "beyond_noise": False,
        "meaning": "",
        "samples_since_last_look": 0,
    }
    sampling = {
        "monuments": monuments if looks else None,
        "predicted": {"error_95_max_m": 6.2e-5, "rms_m": 2e-5, "random_rms_m": 4e-5},
        "measured": 58,
        "set_aside": 12,
        "wanted": 60,
    }
    changed = copy.deepcopy(result)
    changed["inputs"]["sampling"] = sampling
    changed["heldout"]["set_aside"] = {
        "samples": 12,
        "rms": {"nominal": 0.005, "registration_only": 0.0042, "calibrated": 6.1e-5},
        "max": {"nominal": 0.009, "registration_only": 0.0078, "calibrated": 1.2e-4},
        "tracker_3d": 5.2e-5,
        "per_sample": [],
        "meaning": "",
    }
    run = {"run_id": 4, "job": "tracker-sampling", "job_config": {"accept": {"max_error_m": 3e-4}}}
    for name, document in (("result.json", changed), ("run.json", run), ("kincal.json", None)):
        text = path.read_text() if document is None else json.dumps(document)
        (folder / name).write_text(text)
    return folder


def test_monuments_and_poses_set_aside_of_a_run_are_shown(
    tmp_path: Path, path: Path, result: dict[str, Any]
) -> None:
    page = Page(render(from_folder(a_run(tmp_path, path, result))))
    text = text_of(page)
    assert "monuments" in {a.get("id") for tag, a in page.elements if tag == "div"}
    assert "the first look saw it: 0.075 mm, within noise; the limit is 0.100 mm" in text
    assert "calibrated 0.061 mm 0.120 mm 0.052 mm" in text
    assert "Poses 58 of 60" in text
    assert "(0.50 of what random poses promise, RMS)" in text
    worst = 1e3 * result["uncertainty"]["predicted_95"]["workspace"]["max"]
    assert f"{worst:.3f} mm of 0.300 mm within" in text


@pytest.mark.parametrize(
    ("looks", "told"), [(0, "No monument was looked at"), (1, "<m2>, m1 were looked at once")]
)
def test_a_run_without_a_second_look_says_that_nothing_vouches_for_the_stand(
    tmp_path: Path, path: Path, result: dict[str, Any], looks: int, told: str
) -> None:
    assert told in text_of(Page(render(from_folder(a_run(tmp_path, path, result, looks)))))


def test_an_observed_arms_page_does_not_show_tool_and_payload_of_the_arm_beside_it(
    tmp_path: Path, path: Path, result: dict[str, Any]
) -> None:
    folder = a_run(tmp_path, path, result)
    run = json.loads((folder / "run.json").read_text())
    run["values"] = {"payload_kg": 1.25, "tool": {"name": "gripper"}, "robot": {"model": "ur3e"}}
    (folder / "run.json").write_text(json.dumps(run))
    assert "payload 1.25 kg" in text_of(Page(render(from_folder(folder))))
    changed = json.loads((folder / "result.json").read_text())
    changed["inputs"]["sampling"]["role"] = "observed_arm"
    (folder / "result.json").write_text(json.dumps(changed))
    text = text_of(Page(render(from_folder(folder))))
    assert "1.25 kg" not in text
    assert "ur3e" not in text


def test_health_numbers_of_earlier_runs_are_drawn(tmp_path: Path, path: Path, result: dict[str, Any]) -> None:
    folder = a_run(tmp_path, path, result)
    changed = json.loads((folder / "result.json").read_text())
    numbers = {"kinematics.rms_after_m.arm": 3e-5, "tracker.drift_m.tracker": 2e-5}
    changed["inputs"]["trend"] = {name: [[1.7e9, v], [1.71e9, 1.1 * v]] for name, v in numbers.items()}
    (folder / "result.json").write_text(json.dumps(changed))
    page = Page(render(from_folder(folder)))
    assert "trend" in {a.get("id") for tag, a in page.elements if tag == "div"}
