"""``cellward rehearse``: a job on a twin of the configured cell."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError, error, present
from cell.poses import from_pose6, log_xi
from cell.store.runs import RunFolder
from cell.usual_delays import ARM_LATE_S, ENCODER_LATE_S
from daemon.config import load_config
from daemon.rehearsal.objects import rehearsal_of, rehearsed_cell
from daemon.rehearsal.play import RehearsedRun, rehearse, steps_of
from daemon.rehearsal.words import outcome_lines, summary_lines
from fakes.world.scenario import Scenario
from fakes.world.world import Operator, World
from procedures.documents import kind_named
from procedures.kind import KINDS, Kind
from procedures.registry import SHIPPED
from tests.kit.cli_harness import CommandLine
from tests.kit.example_cell import LASER_TRACKER, whole_example
from tests.kit.log_handlers import logging_as_before
from tests.kit.whole_results import whole

__all__ = ["logging_as_before"]
pytestmark = pytest.mark.usefixtures("logging_as_before")

FEW = {
    "placements = 3": "placements = 1",
    "poses_per_placement = 20": "poses_per_placement = 6",
}
OTHER = '[target.b]\ntype = "chessboard"\ncolumns = 6\nrows = 5\nsquare_m = 0.03'
SLOT = "[job.slot-insertion]"
FETCH = f'{SLOT}\nfetch_pose = "wait"\nput_down_pose = "place"'
MARKER = """[job.slot-insertion.marker]
dictionary = "{}"
id = 0
size_m = 0.014
T_slot_marker = [0.0, 0.03, 0.0, 3.1416, 0.0, 0.0]
sigma_m = 0.0001
"""
SWAPPED = """[job.tracker-sampling]
swap_by_operator = true
monument_every = 4
max_predicted_m = 0.05"""
BELT_SPEEDS = {
    "speed_m_s = 0.25\naccel_m_s2 = 0.5\njoint_speed_rad_s = 0.8": (
        "speed_m_s = 1.5\naccel_m_s2 = 6.0\njoint_speed_rad_s = 2.5"
    )
}


def test_a_capture_is_rehearsed_on_a_twin_of_the_example(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cellward = CommandLine(monkeypatch, capsys, whole_example(tmp_path, FEW))
    ran = cellward("rehearse", "cone-capture", "--json", "--out", str(tmp_path / "out"))
    rehearsal = json.loads(ran.out)["rehearsals"][0]
    assert rehearsal["ended"] == "complete"
    assert rehearsal["seconds"] > 10.0
    assert rehearsal["stated"]
    assert rehearsal["off"]
    assert ran.code == (0 if rehearsal["succeeded"] else 1)


@pytest.mark.parametrize(
    ("job", "parts"),
    [
        ("cone-capture", {"camera", "target"}),
        ("laser-reference", {"beams", "io"}),
        ("laser-update", {"beams", "io"}),
        ("latency-calibration", {"beams", "io"}),
        ("tracker-sampling", {"tracker", "reflectors"}),
        ("belt-calibration", {"camera", "belt", "items"}),
        ("belt-tracking", {"camera", "belt", "items", "gripper"}),
        ("touch-test", {"camera", "target"}),
        ("eye-to-hand-check", {"camera", "target"}),
        ("slot-insertion", {"camera", "target", "gripper", "rack"}),
    ],
)
def test_a_twin_has_what_its_job_meets_and_no_address_of_the_cell(
    job: str, parts: set[str], tmp_path: Path
) -> None:
    path = whole_example(tmp_path, BELT_SPEEDS)
    subject = rehearsed_cell(load_config(path), path, job, 1, tmp_path)
    world = Scenario.load(tmp_path / "scenario.toml").world
    present = {name for name in ("camera", "target", "beams", "io", "tracker") if getattr(world, name)}
    present |= {name for name in ("reflectors", "belt", "items", "gripper", "rack") if getattr(world, name)}
    assert parts <= present
    assert subject.jobs[-1] == job
    assert subject.config.cell.twin
    assert {device.driver.partition(":")[0] for device in subject.config.device.values()} == {"fakes.object"}
    assert "192.168" not in json.dumps(subject.config.model_dump(mode="json"))


def test_the_same_seed_draws_the_same_cell_and_another_one_another(tmp_path: Path) -> None:
    path = whole_example(tmp_path)
    config, texts = load_config(path), []
    for seed in (1, 1, 2):
        rehearsed_cell(config, path, "laser-update", seed, tmp_path)
        texts.append((tmp_path / "scenario.toml").read_text("utf-8"))
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_what_a_twin_draws_is_around_what_the_configuration_says(tmp_path: Path) -> None:
    path = whole_example(tmp_path)
    config = load_config(path)
    rehearsed_cell(config, path, "cone-capture", 3, tmp_path)
    camera = Scenario.load(tmp_path / "scenario.toml").world.camera
    assert camera is not None
    assert camera.nominal == config.robot.T_flange_camera_nominal
    assert camera.T_flange_camera != camera.nominal
    assert camera.T_flange_camera == pytest.approx(camera.nominal, abs=0.08)


def test_the_stamps_of_a_twin_are_late_by_what_its_seed_draws(tmp_path: Path) -> None:
    path, late = whole_example(tmp_path, BELT_SPEEDS), []
    for seed in (1, 2):
        rehearsed_cell(load_config(path), path, "belt-tracking", seed, tmp_path)
        world = Scenario.load(tmp_path / "scenario.toml").world
        arm_s = world.arm.reported.stamp_late_s
        late.append((present(world.camera, "camera").stamp_late_s, present(world.belt, "belt").late_s, arm_s))
    for camera_s, encoder_s, arm_s in late:
        assert 0.0 < abs(camera_s) < 0.002
        assert ENCODER_LATE_S[0] <= encoder_s <= ENCODER_LATE_S[1]
        assert ARM_LATE_S[0] <= arm_s <= ARM_LATE_S[1]
    assert late[0] != late[1]


@pytest.mark.parametrize(
    ("device", "noise", "one_by_one"),
    [
        ({}, (1e-3, 5e-6), True),
        (LASER_TRACKER, (15e-6, 6e-6), False),
        ({'driver = "geocom"\n': 'driver = "geocom"\nsigma0_m = 0.1\n'}, (0.1, 5e-6), True),
    ],
)
def test_a_twin_has_the_instrument_that_the_cell_has(
    device: dict[str, str], noise: tuple[float, float], one_by_one: bool, tmp_path: Path
) -> None:
    path = whole_example(tmp_path, device)
    rehearsed_cell(load_config(path), path, "tracker-sampling", 1, tmp_path)
    tracker = Scenario.load(tmp_path / "scenario.toml").world.tracker
    assert tracker is not None
    assert (tracker.sigma0_m, tracker.sigma_per_m) == pytest.approx(noise)
    assert tracker.one_by_one == one_by_one


def test_a_touch_test_comes_after_its_own_capture_and_a_person_holds_the_point(tmp_path: Path) -> None:
    path = whole_example(tmp_path, FEW)
    subject = rehearsed_cell(load_config(path), path, "touch-test", 1, tmp_path)
    assert subject.jobs == ("cone-capture", "touch-test")
    assert [(step.moves_board, step.held is not None) for step in steps_of(subject)] == [
        (True, False),
        (False, True),
    ]
    assert subject.config.job_section("cone-capture")["accept"]["auto"]
    # One place for the capture, and one more where the board lies for the test.
    assert len(Scenario.load(tmp_path / "scenario.toml").world.placement) == 2


@pytest.mark.parametrize(
    ("replaced", "jobs"),
    [
        ({}, ("belt-calibration", "belt-tracking")),
        ({"[job.belt-calibration]": '[job.belt-calibration]\nsource = "touch"'}, ("belt-tracking",)),
    ],
)
def test_picking_comes_after_the_belts_own_calibration_where_a_camera_makes_it(
    replaced: dict[str, str], jobs: tuple[str, ...], tmp_path: Path
) -> None:
    path = whole_example(tmp_path, BELT_SPEEDS | replaced)
    subject = rehearsed_cell(load_config(path), path, "belt-tracking", 1, tmp_path)
    assert subject.jobs == jobs
    assert [step.picks for step in steps_of(subject)][-1] == 10


@pytest.mark.parametrize(
    "replaced",
    [
        {
            "payload_kg": "T_flange_target_nominal = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]\npayload_kg",
            "placements = 3": 'setup = "eye-to-hand"\nplacements = 3',
        },
        {
            'target = "board"\nlook_pose': 'target = "b"\nlook_pose',
            "[target.board]": f"{OTHER}\n[target.board]",
        },
    ],
)
def test_a_touch_test_behind_a_capture_of_another_board_or_camera_is_refused(
    replaced: dict[str, str], tmp_path: Path
) -> None:
    path = whole_example(tmp_path, replaced)
    with pytest.raises(CellError, match="another target or a fixed camera"):
        rehearsed_cell(load_config(path), path, "touch-test", 1, tmp_path)


@pytest.mark.parametrize(
    ("job", "replaced", "words"),
    [
        ("cone", {}, "there is no job 'cone'; these can be rehearsed: cone-capture"),
        ("laser-check", {"[job.laser-reference]": "[job.laser-check]\n[other]"}, "[job.laser-reference]"),
        ("belt-tracking", {"belt_nominal = {": "# belt_nominal = {"}, "belt_nominal is missing"),
        ("tracker-sampling", {"T_base_tracker_nominal": "# T_base"}, "T_base_tracker_nominal of the job"),
        (
            "cone-capture",
            {"T_flange_camera_nominal": "# T_flange_camera_nominal"},
            "has no T_flange_camera_nominal",
        ),
        ("eye-to-hand-check", {"T_base_camera_nominal": "# T_base_camera"}, "has no T_base_camera_nominal"),
        ("eye-to-hand-check", {'fixed_camera = "belt': '# fixed = "belt'}, "no device for fixed_camera"),
        ("eye-to-hand-check", {'start_pose = "show"': 'start_pose = "home"'}, "give start_pose a pose"),
        (
            "slot-insertion",
            {"[0.0, 0.0, 0.08": "[0.01, 0.0, 0.08"},
            "the tool's point is 10.000 mm beside it",
        ),
        ("slot-insertion", {"[0.0, 0.0, 0.08": "[0.0, 0.0, 0.0"}, "and 0.000 mm behind the front of a part"),
        ("slot-insertion", {SLOT: f'{SLOT}\nput_down_pose = "nowhere"'}, "[poses] has no 'nowhere'"),
        ("slot-insertion", {SLOT: f"{MARKER.format('DICT_NOPE')}{SLOT}"}, "marker.dictionary: "),
    ],
)
def test_what_the_configuration_lacks_is_said(
    job: str, replaced: dict[str, str], words: str, tmp_path: Path
) -> None:
    if "[job.laser-reference]" in replaced:  # the whole section goes
        replaced = {}
        path = whole_example(tmp_path)
        text = path.read_text("utf-8")
        begin, end = text.index("[job.laser-reference]"), text.index("[job.tracker-sampling]")
        path.write_text(text[:begin] + text[end:], "utf-8")
    else:
        path = whole_example(tmp_path, replaced | BELT_SPEEDS)
    with pytest.raises(CellError) as refused:
        rehearsal_of(load_config(path), job)
    assert words in refused.value.detail


@pytest.mark.parametrize(
    ("replaced", "in_slots", "fetched", "handed"),
    [
        ({}, [], False, True),
        ({SLOT: FETCH}, [], True, False),
        ({SLOT: f'{SLOT}\naction = "pull"\nput_down_pose = "place"'}, [1], False, False),
        ({SLOT: f'{FETCH}\naction = "replace"'}, [1], True, False),
    ],
)
def test_parts_are_where_an_insertion_takes_them(
    replaced: dict[str, str], in_slots: list[int], fetched: bool, handed: bool, tmp_path: Path
) -> None:
    path = whole_example(tmp_path, replaced)
    subject = rehearsed_cell(load_config(path), path, "slot-insertion", 1, tmp_path)
    scenario = Scenario.load(tmp_path / "scenario.toml")
    rack, world = present(scenario.world.rack, "rack"), World.from_scenario(scenario)
    assert [part.slot for part in rack.parts if part.slot is not None] == in_slots
    assert [step.part_in_hand for step in steps_of(subject)] == [False, handed]
    assert (rack.handed is not None) == handed
    # The tool is 0.18 m long, and the part's front 0.08 m before its point.
    nominal, gripped = from_pose6([0.0, 0.0, 0.26, 0.0, 0.0, 0.0]), None
    if handed:
        gripped = from_pose6(present(rack.handed, "handed part"))
    elif fetched:
        flange = world.true.forward(subject.config.poses["wait"])
        gripped = flange.inv() * from_pose6(present(rack.parts[-1].T_base_part, "place of the part"))
    if gripped is not None:
        off = log_xi(nominal.inv() * gripped)
        assert 0.0 < np.linalg.norm(off[:3]) < 5e-4
        assert 0.0 < np.linalg.norm(off[3:]) < 5e-3


def test_an_insertion_is_rehearsed_with_a_part_that_a_person_puts_into_the_gripper(tmp_path: Path) -> None:
    good_board = {
        "scale_sigma = 0.0005": "scale_sigma = 0.0001",
        "flatness_m = 0.0002": "flatness_m = 0.00002",
        "poses_per_placement = 20": "poses_per_placement = 12",
        "camera_sigma = { f = 0.003, c_px = 5.0 }": "camera_sigma = { f = 0.0003, c_px = 0.5 }",
    }
    path = whole_example(tmp_path, FEW | good_board)
    outcome = rehearse(load_config(path), path, "slot-insertion", 1, tmp_path)
    assert outcome.ended == "complete", outcome.why
    assert outcome.stated
    assert outcome.off


def test_a_prompt_that_comes_again_and_again_ends_the_rehearsal_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Operator, "confirm", lambda subject, _, t: subject.remove(t))  # nobody has the board
    path = whole_example(tmp_path, FEW)
    outcome = rehearse(load_config(path), path, "cone-capture", 1, tmp_path)
    assert outcome.ended == "stopped"
    assert not outcome.succeeded
    assert outcome.why[0].startswith("this was asked again and again, and doing it did not help: ")


def test_a_rehearsal_says_how_it_ended_and_what_fell_out() -> None:
    lost = ["pose skipped: outside the workspace"] * 2 + [f"pose skipped: {n}" for n in range(6)]
    bad = RehearsedRun(2, "aborted", 12.0, why=["No plan (3010). Move the board."], lost=lost)
    good = RehearsedRun(1, "complete", 95.0, "pass", "0.1 mm", "0.05 mm", True)
    text = "\n".join(outcome_lines("cone-capture", bad))
    assert "twin 2: aborted after 12 s of the cell" in text
    assert "No plan (3010)" in text
    assert "outside the workspace (2 times)" in text
    assert "and 2 more reasons" in text
    assert "off the twin's truth: 0.05 mm, which agrees with it" in "\n".join(outcome_lines("x", good))
    (line,) = summary_lines("cone-capture", [good, bad])
    assert line.startswith("cone-capture: ended well in 1 of 2 twins, in 1 min 35 s to 1 min 35 s")
    assert (good.succeeded, bad.succeeded) == (True, False)


def test_twins_in_which_nothing_could_be_started_say_why_in_one_sentence() -> None:
    why = "its cone-capture was judged warn: few views, and was not accepted"
    first, other = (RehearsedRun(n, "not started", 95.0, why=[w]) for n, w in ((1, why), (2, "no arm.")))
    (line,) = summary_lines("touch-test", [first, other, first])
    start = "touch-test: could not be started in any of 3 twins: in 2 of them because"
    assert line == f"{start} its cone-capture was judged warn: few views, and was not accepted"
    (line,) = summary_lines("touch-test", [other, other])
    assert line == "touch-test: could not be started in any of 2 twins: no arm"
    told = next(outcome_lines("touch-test", first))
    assert told == "touch-test, twin 1: not started; what comes first took 1 min 35 s of the cell"


def test_the_target_of_a_check_is_where_the_job_says_to_what_it_states(tmp_path: Path) -> None:
    """The job's own sigma of the place, not a bracket's."""
    given, offs = from_pose6([0.1, 0.1, 0.05, 0.0, 3.1416, 0.0]), []
    exact = {"place_sigma_t_m = 0.0001": "place_sigma_t_m = 0.0"}
    for seed, replaced in ((1, {}), (2, {}), (1, exact)):
        path = whole_example(tmp_path, replaced)
        rehearsed_cell(load_config(path), path, "eye-to-hand-check", seed, tmp_path)
        (placement,) = Scenario.load(tmp_path / "scenario.toml").world.placement
        assert placement.T_flange_target is not None
        # The place is off at the flange: T_marker_flange exp(xi).
        offs.append(log_xi(given.inv() * from_pose6(placement.T_flange_target).inv()))
    assert 1e-6 < np.linalg.norm(offs[0][:3]) < 5e-4
    assert 1e-6 < np.linalg.norm(offs[0][3:]) < 1.5e-3
    assert np.linalg.norm(offs[0] - offs[1]) > 1e-6
    assert np.linalg.norm(offs[2][:3]) < 1e-9


def test_a_job_that_no_truth_can_judge_is_told_beside_its_prediction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def played(config: Any, steps: Any) -> tuple[list[tuple[int, dict[str, Any]]], None]:
        runs = Path(config.cell.state_dir) / "runs"
        run = RunFolder.create(runs, steps[-1].job, 1, {}, MonotonicClock())
        run.write_result(whole({"kind": "iso9283", "verdict": "pass", "result": {}}))
        run.finish({"outcome": "complete", "packml": "COMPLETE", "verdict": "pass", "error": None})
        return [(1, {})], None

    monkeypatch.setattr("daemon.rehearsal.play.run_objects", played)
    without = replace(kind_named("iso9283"), truth="")  # as a job of another package may be
    monkeypatch.setitem(cast(dict[str, Kind], KINDS), "iso9283", without)
    told = {"text": "14 arrivals"}
    monkeypatch.setattr("daemon.rehearsal.play.prediction_of", lambda *_: told)
    path = whole_example(tmp_path)
    subject = rehearse(load_config(path), path, "iso9283", 1, tmp_path)
    assert (subject.good, subject.inside95, subject.succeeded) == (None, None, True)
    text = "\n".join(outcome_lines("iso9283", subject))
    assert "  expected of the cell: 14 arrivals" in text
    assert "P1: AP " in text
    assert "not compared with the twin's truth: there is no such comparison" in text
    assert "agree" not in text + "".join(summary_lines("iso9283", [subject, subject]))


def test_a_twin_whose_preparation_was_not_accepted_is_told_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = iter([("complete", "warn"), ("complete", "pass"), ("aborted", None)])

    def played(config: Any, steps: Any) -> None:
        outcome, verdict = next(ends)
        runs = Path(config.cell.state_dir) / "runs"
        run = RunFolder.create(runs, steps[0].job, 1, {}, MonotonicClock())
        if verdict is not None:
            kind = {"kind": "cone-capture", "result": None, "reasons": ["few views", "a wide interval"]}
            run.write_result(whole({**kind, "verdict": verdict}))
        run.finish({"outcome": outcome, "packml": outcome.upper(), "verdict": verdict, "error": None})
        raise error("HAND_EYE_UNKNOWN", "no result of cone-capture is in effect")

    monkeypatch.setattr("daemon.rehearsal.play.run_objects", played)
    cellward = CommandLine(monkeypatch, capsys, whole_example(tmp_path, FEW))
    ran = cellward("rehearse", "touch-test", "--times", "3", "--json", "--out", str(tmp_path / "out"))
    told = json.loads(ran.out)["rehearsals"]
    assert [(t["seed"], t["ended"]) for t in told] == [(1, "not started"), (2, "not started"), (3, "aborted")]
    first, second, third = (t["why"][0] for t in told)
    assert first == "its cone-capture was judged warn: few views; a wide interval, and was not accepted"
    assert "no result of cone-capture is in effect (5506)" in second
    assert third == "cone-capture, which has to come first, did not end well"
    assert ran.code == 1


def test_a_job_that_went_on_without_a_preparation_that_was_not_accepted_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def played(config: Any, steps: Any) -> tuple[list[tuple[int, dict[str, Any]]], float]:
        runs = Path(config.cell.state_dir) / "runs"
        for number, verdict in ((1, "warn"), (2, "pass")):
            run = RunFolder.create(runs, steps[number - 1].job, number, {}, MonotonicClock())
            result = {"kind": "belt-calibration", "result": None, "verdict": verdict}
            run.write_result(whole({**result, "warnings": [{"code": "belt.nominal", "text": "5 % off"}]}))
            run.finish({"outcome": "complete", "packml": "COMPLETE", "verdict": verdict, "error": None})
        return [(1, {}), (2, {})], 1.0

    monkeypatch.setattr("daemon.rehearsal.play.run_objects", played)
    path = whole_example(tmp_path, BELT_SPEEDS)
    outcome = rehearse(load_config(path), path, "belt-tracking", 1, tmp_path)
    assert outcome.why == ["its belt-calibration was judged warn: 5 % off, and was not accepted"]


def test_a_prompt_that_belongs_to_each_of_many_steps_ends_no_rehearsal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.demo.fast.MOST_ASKED", 1)
    swapped = {"[job.tracker-sampling]": SWAPPED, "poses = 40": "poses = 16"}
    path = whole_example(tmp_path, LASER_TRACKER | swapped)
    outcome = rehearse(load_config(path), path, "tracker-sampling", 1, tmp_path)
    assert outcome.ended == "complete", outcome.why


def test_every_job_is_rehearsed_and_one_of_another_package_that_cannot_be_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not [name for name, job in SHIPPED.items() if not kind_named(job.kind).rehearsal]
    without = replace(kind_named("corrected-targets"), rehearsal="")
    monkeypatch.setitem(cast(dict[str, Kind], KINDS), "corrected-targets", without)
    cellward = CommandLine(monkeypatch, capsys, whole_example(tmp_path))
    ran = cellward("rehearse", "corrected-targets", "--out", str(tmp_path / "out"))
    assert ran.code == 2
    refused = "corrected-targets cannot be rehearsed yet; these jobs can: cone-capture, eye-to-hand-check"
    assert refused in ran.err
    assert "Rehearsing" not in ran.err


def test_an_insertion_behind_a_capture_with_a_fixed_camera_is_refused(tmp_path: Path) -> None:
    fixed = {
        "payload_kg": "T_flange_target_nominal = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]\npayload_kg",
        "placements = 3": 'setup = "eye-to-hand"\nplacements = 3',
    }
    path = whole_example(tmp_path, fixed)
    with pytest.raises(CellError, match=r"\[job.cone-capture\] has setup = \"eye-to-hand\""):
        rehearsed_cell(load_config(path), path, "slot-insertion", 1, tmp_path)


def test_a_second_rehearsal_says_where_the_reports_of_the_first_one_are_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def played(config: Any, _steps: Any) -> None:
        (Path(config.cell.state_dir) / "runs").mkdir(parents=True)
        raise error("DEVICE_NOT_READY", "arm")

    monkeypatch.setattr("daemon.rehearsal.play.run_objects", played)
    cellward = CommandLine(monkeypatch, capsys, whole_example(tmp_path))
    words = ("rehearse", "cone-capture", "--out", str(tmp_path / "out"))
    assert "earlier" not in cellward(*words).err
    folder = tmp_path / "out" / "cone-capture-1"
    said = f"What an earlier rehearsal left in {folder}/state, its reports too, is now in {folder}/state-1"
    assert said in cellward(*words).err
    assert (folder / "state-1").is_dir()
