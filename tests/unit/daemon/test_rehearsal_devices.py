"""What a twin of ``cellward rehearse`` has of the sections of the cell's devices."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest

from cell.errors import CellError, error, present
from cell.kinds import plays
from cell.store.runs import list_runs
from daemon.config import load_config
from daemon.config.drivers import DRIVERS, driver_class
from daemon.config.roles import ROLES
from daemon.rehearsal.objects import rehearsed_cell
from daemon.rehearsal.play import rehearse
from daemon.rehearsal.sections import SECTIONS
from fakes.world.scenario import Scenario
from tests.kit.cli_harness import CommandLine
from tests.kit.example_cell import ENCODER_DELAY, LASER_TRACKER, palletizer_example, whole_example

BELT_SPEEDS = {
    "speed_m_s = 0.25\naccel_m_s2 = 0.5\njoint_speed_rad_s = 0.8": (
        "speed_m_s = 1.5\naccel_m_s2 = 6.0\njoint_speed_rad_s = 2.5"
    )
}
FEW = {"placements = 3": "placements = 1", "poses_per_placement = 20": "poses_per_placement = 6"}
PICKS = BELT_SPEEDS | {
    "[job.belt-calibration]": '[job.belt-calibration]\nsource = "touch"',
    "[job.belt-tracking]": "[job.belt-tracking]\npicks = 2",
}
ARM = 'driver = "ur"\n'
CAMERA = '[device.camera]\ndriver = "oak"\n'
ABOVE = '[device.belt_camera]\ndriver = "oak"\n'
EXPOSED = "exposure_s = 0.002 "
MODULE = 'module = "ioLogik-E1210" '
GENERIC = {MODULE: 'module = "generic" '}
ARM_INPUTS = {
    'driver = "modbus-inputs" ': 'driver = "arm-inputs" ',
    'url = "tcp://192.168.10.30:502" ': 'arm = "arm" ',
    MODULE: "# module ",
    "poll_period_s = 0.005\n": "",
    "filter_s = 0.001 ": "# filter_s ",
}
STATION = 'driver = "geocom"\n'
LINES = 'driver = "line-stream"\n'
CANOPEN = 'driver = "canopen-encoder" '
RAW = {CANOPEN: 'driver = "raw-can-encoder"\nid = 5 ', "node = 5\n": ""}
CONFIRM = "confirm = 7 "
PLACE = '[device.place]\ndriver = "modbus-inputs"\nurl = "tcp://192.168.10.31:502"\n'
CLEAR = BELT_SPEEDS | {
    'gripper = "gripper"\n': 'gripper = "gripper"\nplace_inputs = "place"\n',
    "[device.gripper]": f"{PLACE}inputs = {{ clear = {{ address = 3 }} }}\n[device.gripper]",
    "[job.belt-tracking]": '[job.belt-tracking]\nplace_clear = "clear"',
}
PALLETIZER = 'driver = "observed-arm"\n'
REQUESTS = "handshake = { targets = [20, 22, 24, 26], number = 30, reached = 40 }\nallow_requests = true "


class Case(NamedTuple):
    """A key that makes another twin: the device before is ``anchor`` in a cell with ``base``."""

    role: str
    key: str
    job: str
    anchor: str
    changed: str
    base: Mapping[str, str] = MappingProxyType({})


def _added(role: str, job: str, anchor: str, *lines: str, base: dict[str, str] | None = None) -> list[Case]:
    return [Case(role, line.split()[0], job, anchor, f"{anchor}{line}\n", base or {}) for line in lines]


PICTURES = (
    "stereo_height = 800", "stereo_subpixel_bits = 5",
    "width = 640", "height = 400", "fps = 20.0", "row_time_s = 0.0", "depth = false", "frame_timeout_s = 1.5"
)  # fmt: skip
CASES = [
    *_added(
        "arm",
        "laser-check",
        ARM,
        "servo_lookahead_s = 0.1",
        "servo_gain = 300.0",
        "joint_tolerance_rad = 0.002",
        "position_tolerance_m = 0.001",
        "rotation_tolerance_rad = 0.002",
    ),
    *_added("flange_camera", "cone-capture", CAMERA, *PICTURES, "exposure_s = 0.002"),
    *_added("fixed_camera", "belt-calibration", ABOVE, *PICTURES),
    Case("fixed_camera", "exposure_s", "belt-calibration", EXPOSED, f"# {EXPOSED}"),
    Case("beams", "inputs", "laser-check", "ys = { address = 1", "ys = { address = 2"),
    Case("beams", "poll_period_s", "laser-check", "poll_period_s = 0.005\n", "poll_period_s = 0.1\n"),
    Case("beams", "filter_s", "laser-check", "filter_s = 0.001 ", "filter_s = 0.1 "),
    Case("beams", "module", "laser-check", MODULE, 'module = "WAGO-750" '),
    Case("beams", "use_counters", "laser-check", MODULE, f"use_counters = false\n{MODULE}"),
    Case(
        "beams",
        "counters",
        "laser-check",
        GENERIC[MODULE],
        f"counters.address = 16\n{GENERIC[MODULE]}",
        GENERIC,
    ),
    Case("beams", "arm", "laser-check", ARM, f"{ARM}rtde_frequency_hz = 125.0\n", ARM_INPUTS),
    *_added("place_inputs", "belt-tracking", PLACE, "poll_period_s = 0.2", base=CLEAR),
    Case(
        "place_inputs",
        "arm",
        "belt-tracking",
        PLACE,
        '[device.place]\ndriver = "arm-inputs"\narm = "arm"\n',
        CLEAR,
    ),
    *_added(
        "tracker",
        "tracker-sampling",
        STATION,
        "sigma0_m = 0.002",
        "sigma_per_m = 0.00001",
        'measure_with = "tracking"',
        "min_readings = 5",
        "poll_period_s = 0.5",
    ),
    *_added("tracker", "tracker-sampling", LINES, 'request = "MEASURE"', base=LASER_TRACKER),
    *_added(
        "belt",
        "belt-calibration",
        "node = 5\n",
        "period_s = 0.01",
        "range_counts = 4096",
        "lost_after_s = 0.5",
    ),
    Case("belt", "width_bits", "belt-calibration", "id = 5 ", "width_bits = 16\nid = 5 ", RAW),
    Case("gripper", "output", "belt-tracking", "output = 0 ", "output = 3 ", BELT_SPEEDS),
    Case("gripper", "confirm", "belt-tracking", CONFIRM, "confirm = 5 ", BELT_SPEEDS),
    Case("gripper", "moves_s", "belt-tracking", CONFIRM, "moves_s = 0.1 ", BELT_SPEEDS),
    Case("observed_arm", "allow_requests", "corrected-targets", "allow_requests = false ", REQUESTS),
    *_added(
        "observed_arm",
        "corrected-targets",
        PALLETIZER,
        "rest_window_s = 1.0",
        "rest_spread_rad = 0.001",
        "poll_period_s = 0.1",
    ),
]  # fmt: skip


def twin_of(folder: Path, job: str, base: Mapping[str, str], *changes: tuple[str, str]) -> str:
    """The scenario and the sections of the devices of a twin for ``job``."""
    example = palletizer_example if job == "corrected-targets" else whole_example
    path = example(folder, dict(base))
    text = path.read_text("utf-8")
    for anchor, changed in changes:
        assert anchor in text
        text = text.replace(anchor, changed, 1)
    path.write_text(text, "utf-8")
    made = rehearsed_cell(load_config(path), path, job, 1, folder)
    devices = {name: device.model_dump(mode="json") for name, device in made.config.device.items()}
    return (folder / "scenario.toml").read_text("utf-8") + json.dumps(devices)


def played(folder: Path, job: str, base: dict[str, str]) -> dict[str, Any]:
    """The result of ``job`` in a twin."""
    folder.mkdir()
    path = whole_example(folder, base)
    outcome = rehearse(load_config(path), path, job, 1, folder)
    assert outcome.ended == "complete", outcome.why
    found: dict[str, Any] = present(list_runs(folder / "state" / "runs")[-1].read_result(), "result")[
        "result"
    ]
    return found


def world_of(folder: Path, job: str, base: dict[str, str]) -> Any:
    twin_of(folder, job, base)
    return Scenario.load(folder / "scenario.toml").world


@pytest.mark.parametrize("name", DRIVERS)
def test_every_key_of_every_driver_is_taken_over_or_of_no_effect_or_named_as_missing(name: str) -> None:
    driver = driver_class(name)
    roles = [role for role, asked in ROLES.items() if plays(driver, asked.protocol)]
    assert roles
    for role in roles:
        known = SECTIONS[role]
        assert set(driver.Config.model_fields) <= known.all, (
            f"{role}: say in SECTIONS what a twin makes of these"
        )


@pytest.mark.parametrize("role", SECTIONS)
def test_a_key_is_in_one_list_and_some_driver_has_it(role: str) -> None:
    subject = SECTIONS[role]
    assert not (subject.taken & subject.no_effect | subject.taken & subject.missing)
    assert not subject.no_effect & subject.missing
    configs = [driver_class(name) for name in DRIVERS if plays(driver_class(name), ROLES[role].protocol)]
    assert subject.taken | subject.missing <= {
        key for driver in configs for key in driver.Config.model_fields
    }


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.role}-{case.key}")
def test_a_key_that_is_taken_over_makes_another_twin(case: Case, tmp_path: Path) -> None:
    before = twin_of(tmp_path, case.job, case.base)
    assert twin_of(tmp_path, case.job, case.base, (case.anchor, case.changed)) != before


def test_there_is_a_case_of_each_key_that_is_taken_over() -> None:
    taken = {(role, key) for role, known in SECTIONS.items() for key in known.taken}
    assert taken == {(case.role, case.key) for case in CASES}


def test_inputs_of_a_large_module_have_a_twin_too(tmp_path: Path) -> None:
    large = {MODULE: 'module = "WAGO-750" ', "ys = { address = 1": "ys = { address = 40"}
    io = present(world_of(tmp_path, "laser-check", large).io, "io")
    assert io.inputs == {"xs": 0, "ys": 1}
    assert not io.counters


def test_a_small_camera_without_depth_sees_the_same_sight_in_fewer_pixels(tmp_path: Path) -> None:
    small = {CAMERA: f"{CAMERA}width = 640\nheight = 400\ndepth = false\n"}
    usual, camera = (
        present(world_of(tmp_path, "cone-capture", base).camera, "camera") for base in ({}, small)
    )
    assert (camera.width, camera.height, camera.depth, camera.stereo) == (640, 400, False, None)
    assert pytest.approx([k / 2 for k in usual.K]) == camera.K
    assert camera.row_time_s == pytest.approx(2 * usual.row_time_s)
    assert usual.stereo is not None


def test_pictures_of_another_shape_are_cut_off_as_the_cameras_are(tmp_path: Path) -> None:
    wide = {CAMERA: f"{CAMERA}width = 1920\nheight = 1080\n"}
    camera = present(world_of(tmp_path, "cone-capture", wide).camera, "camera")
    assert camera.K[:2] == pytest.approx([1200.0, 1200.0])


def test_a_camera_without_exposure_s_exposes_by_the_light(tmp_path: Path) -> None:
    world = world_of(tmp_path, "belt-calibration", {EXPOSED: f"# {EXPOSED}"})
    camera = present(world.camera, "camera")
    assert camera.exposure().time_s == pytest.approx(0.027)
    fixed = present(world_of(tmp_path, "belt-calibration", {}).camera, "camera")
    assert fixed.exposure().time_s == 0.002


def test_an_unconfirmed_gripper_moves_within_what_its_section_says(tmp_path: Path) -> None:
    world = world_of(tmp_path, "belt-tracking", BELT_SPEEDS | {CONFIRM: "moves_s = 1.5 "})
    gripper = present(world.gripper, "gripper")
    assert gripper.confirm is None
    assert 1.05 <= gripper.close_s <= 1.5


@pytest.mark.parametrize(("height", "focal"), [(800, 812.0), (720, 800.0)])
def test_a_lens_that_the_hand_eye_in_effect_found_for_such_pictures_makes_them(
    height: int, focal: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lens = {"width": 1280, "height": height, "K": [812.0, 811.0, 644.0, 395.0], "dist": [0.1] * 5}
    found = {"T_flange_camera": {"lens": lens}}
    monkeypatch.setattr("daemon.predictions._stated_now", lambda _, name: found.get(name, {}))
    camera = present(world_of(tmp_path, "cone-capture", {}).camera, "camera")
    assert camera.K[0] == focal
    assert camera.told.focal != 0.0
    fixed = present(world_of(tmp_path, "belt-calibration", {}).camera, "camera")
    assert fixed.K[0] == 800.0


MEASURED = {  # 15 and -2 ms against the arm, to 0.5 and 0.8 ms (95 %)
    "time_offset_s.belt_camera": {"interval95_s": (0.0145, 0.0155)},
    "time_offset_s.belt": {"interval95_s": (-0.0028, -0.0012)},
}


def test_a_delay_that_the_cell_has_measured_is_drawn_about_that_value_as_well_as_it_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.predictions._stated_now", lambda _, name: MEASURED.get(name, {}))
    path, late = whole_example(tmp_path), []
    for seed in range(40):
        rehearsed_cell(load_config(path), path, "belt-calibration", seed, tmp_path)
        world = Scenario.load(tmp_path / "scenario.toml").world
        camera, belt = present(world.camera, "camera"), present(world.belt, "belt")
        arm_s = world.arm.reported.stamp_late_s
        late.append((camera.stamp_late_s - arm_s, belt.late_s + 0.5 * belt.jitter_s - arm_s))
    sigmas = np.array([0.0005, 0.0008]) / 1.96
    np.testing.assert_allclose(np.mean(late, axis=0), [0.015, -0.002], atol=4 * sigmas.max() / np.sqrt(40))
    np.testing.assert_allclose(np.std(late, axis=0), sigmas, rtol=0.4)


CAMERA_DELAY = {"name": "time_offset_s.belt_camera", "state": "committed", "version": 3}


@pytest.mark.parametrize(("version", "together"), [(3, True), (2, False), (None, False)])
def test_an_encoder_that_was_measured_by_the_camera_in_effect_shares_its_error(
    version: int | None, together: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, sigma_s = str(CAMERA_DELAY["name"]), 0.0005 / 1.96
    by = {"camera_calibration": name, "camera_sigma_s": sigma_s} | (
        {} if version is None else {"camera_version": version}
    )
    found = MEASURED | {"time_offset_s.belt": MEASURED["time_offset_s.belt"] | by}
    monkeypatch.setattr("daemon.predictions._stated_now", lambda _, name: found.get(name, {}))
    monkeypatch.setattr("daemon.predictions.ledger_rows", lambda _: [CAMERA_DELAY])
    path, late = whole_example(tmp_path), []
    for seed in range(60):
        rehearsed_cell(load_config(path), path, "belt-calibration", seed, tmp_path)
        world = Scenario.load(tmp_path / "scenario.toml").world
        arm_s = world.arm.reported.stamp_late_s
        late.append((present(world.camera, "").stamp_late_s - arm_s, present(world.belt, "").late_s - arm_s))
    shared = np.cov(np.transpose(late))
    assert np.sqrt(shared[1, 1]) == pytest.approx(0.0008 / 1.96, rel=0.4)
    assert np.corrcoef(np.transpose(late))[0, 1] == pytest.approx(5 / 8 if together else 0.0, abs=0.3)
    outcome = rehearse(load_config(path), path, "belt-calibration", 1, tmp_path)
    assert outcome.ended == "complete", outcome.why
    (run,) = list_runs(tmp_path / "state" / "runs")
    known = json.loads((run.path / "run.json").read_text("utf-8"))["values"]["time_offset_s"]["belt"]
    expected = {3: pytest.approx(sigma_s), 2: 0.0, None: None}
    assert known.get("camera_sigma") == expected[version]


@pytest.mark.parametrize(
    ("device", "late_s", "half_s"),
    [("belt_camera", 0.25, 0.001), ("belt_camera", 0.1, 0.05), ("belt", -0.2, 0.0)],
)
def test_a_measured_delay_beyond_that_of_any_twin_is_refused_by_its_name(
    device: str, late_s: float, half_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"time_offset_s.{device}"
    found = {name: {"interval95_s": (late_s - half_s, late_s + half_s)}}
    monkeypatch.setattr("daemon.predictions._stated_now", lambda _, name: found.get(name, {}))
    path = whole_example(tmp_path)
    with pytest.raises(CellError) as caught:
        rehearsed_cell(load_config(path), path, "belt-calibration", 1, tmp_path)
    told = str(caught.value)
    assert f"{name} in effect is {1e3 * late_s:.1f} +- {1e3 * half_s:.1f} ms (95 %), and stamps of a" in told
    assert f"'cellward rollback {name}'" in told
    assert "likely cell" not in told


@pytest.mark.parametrize("job", ["belt-calibration", "latency-calibration"])
def test_the_job_in_a_rehearsal_knows_the_delays_that_the_cell_has_measured_and_no_more(
    job: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.predictions._stated_now", lambda _, name: MEASURED.get(name, {}))
    short = {key: f"{text}\nchanges = 8\nsightings = 60" for key, text in ENCODER_DELAY.items()}
    path = whole_example(tmp_path, short)
    outcome = rehearse(load_config(path), path, job, 1, tmp_path)
    assert (outcome.ended, outcome.good) == ("complete", True), outcome.why
    (run,) = list_runs(tmp_path / "state" / "runs")
    known = json.loads((run.path / "run.json").read_text("utf-8"))["values"]["time_offset_s"]
    for role, late_s, sigma_s in (("fixed_camera", 0.015, 0.0005 / 1.96), ("belt", -0.002, 0.0008 / 1.96)):
        assert known[role] == pytest.approx({"effective": late_s, "applied": 0.0, "sigma": sigma_s}, rel=1e-3)


def test_a_ledger_that_may_not_be_read_keeps_nobody_from_rehearsing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise error("ACCESS_DENIED", "ledger.sqlite")

    monkeypatch.setattr("daemon.predictions._stated_now", refused)
    assert present(world_of(tmp_path, "cone-capture", {}).camera, "camera").K[0] == 800.0


def test_a_capture_with_fewer_pixels_states_more(tmp_path: Path) -> None:
    small = {CAMERA: f"{CAMERA}width = 640\nheight = 400\ndepth = false\n"}
    usual, fewer = (played(tmp_path / n, "cone-capture", FEW | base) for n, base in (("a", {}), ("b", small)))
    assert np.trace(fewer["cov"]) > 1.4 * np.trace(usual["cov"])


def test_items_are_not_found_by_the_depth_of_a_camera_without(tmp_path: Path) -> None:
    path = whole_example(tmp_path, PICKS | {ABOVE: f"{ABOVE}depth = false\n"})
    outcome = rehearse(load_config(path), path, "belt-tracking", 1, tmp_path)
    assert outcome.ended == "aborted"
    assert "this camera has none" in outcome.why[0]


def test_an_arm_that_looks_farther_ahead_is_later_and_a_long_exposure_leaves_more_open(
    tmp_path: Path,
) -> None:
    smeared = played(tmp_path / "a", "belt-tracking", PICKS | {EXPOSED: f"# {EXPOSED}"})
    late = played(tmp_path / "b", "belt-tracking", PICKS | {ARM: f"{ARM}servo_lookahead_s = 0.1\n"})
    usual = played(tmp_path / "c", "belt-tracking", PICKS)
    assert late["arm_lag_s"] - usual["arm_lag_s"] == pytest.approx(0.05, abs=0.005)
    assert smeared["contact_95_m"] > usual["contact_95_m"]


def test_what_a_twin_does_not_have_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told = {
        CAMERA: f'{CAMERA}stereo_preset = "density"\nfocus = 120\n',
        ARM: f"{ARM}rtde_frequency_hz = 125.0\n",
    }
    cellward = CommandLine(monkeypatch, capsys, whole_example(tmp_path, told | FEW))
    ran = cellward("rehearse", "cone-capture", "--out", str(tmp_path / "out"))
    line = "not in the twin: rtde_frequency_hz of arm; focus, stereo_preset of camera\n"
    assert line in ran.out


def test_nothing_is_told_of_a_cell_whose_twin_has_all(tmp_path: Path) -> None:
    path = whole_example(tmp_path)
    assert rehearsed_cell(load_config(path), path, "laser-check", 1, tmp_path).missing == ()
