"""``cellward check``: findings, predictions, and the probe."""

import asyncio
import json
import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from cell.store.ledger import Ledger
from cell.wire_recording.reader import read_recording
from daemon.cli import machine
from daemon.cli.check import _clauses
from daemon.cli.probe import probe_devices
from daemon.config import init_text, load_config
from daemon.demo.fast import write_config as write_demo_config
from daemon.demo.scenes import DemoScene
from procedures.hand_eye.plan import plan_placement
from procedures.laser.plan import plan_scan
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.object_cell import PLANNERS, write_config
from tests.kit.permissions import without_override
from tests.kit.remembered import predicted_roughly

BOX = [{"min": [-1.5, -1.5, -1.0], "max": [1.5, 1.5, 2.0]}]


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    return CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)


@pytest.fixture(autouse=True)
def _planned_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few dozen commands ask for the same handful of plans."""
    monkeypatch.setattr("procedures.hand_eye.expectation.plan_placement", PLANNERS[plan_placement])
    monkeypatch.setattr("procedures.laser.expectation.plan_scan", PLANNERS[plan_scan])
    monkeypatch.setattr("procedures.laser.expectation.predict", predicted_roughly)


@pytest.fixture
def objects(tmp_path: Path) -> Path:
    """A valid configuration whose devices are the twin's objects."""
    scene = DemoScene("bay", ())
    scene.prepare(tmp_path)
    return write_demo_config(scene, tmp_path)


def test_a_valid_file_is_said_to_be_valid_with_what_can_be_expected(
    subject: CommandLine, objects: Path
) -> None:
    shown, as_json = subject("check", "-c", objects), subject("check", "-c", objects, "--json")
    assert (shown.code, as_json.code) == (0, 0)
    assert "is valid" in shown.out
    assert "11 of 12 poses are reached" in shown.out  # steeper laps lose one for what the rest tell
    assert any(line.startswith("  expected error below") for line in shown.out.splitlines())
    prediction, beams = json.loads(as_json.out)["predictions"]
    # 36 poses at half a metre with 0.1 px: between a hundredth and half a millimetre.
    assert 1e-5 < prediction["predicted"]["error95_t_m"] < 5e-4

    assert "every move keeps the limits" in shown.out
    assert beams["slide_m"] == pytest.approx(0.025 * 0.005)
    assert beams["problems"] == []
    assert 0.0 < beams["U_z_m"] < beams["slide_m"]
    assert 0.0 < beams["U_xy_m"] < beams["slide_m"]
    assert beams["detectable_m"] > beams["tolerance_m"] >= 1e-4
    for gate, told in (
        (beams, "called moved in 1 of 300 checks at most, one that moved by"),
        (beams["second_scan"], "turned down in 1 of 300 updates at most, one that is wrong by"),
    ):
        assert f"{told} {1e3 * gate['detectable_m']:.3f} mm in 99 of 100" in shown.out
    assert beams["detectable_m"] > beams["second_scan"]["detectable_m"] > beams["second_scan"]["U_m"] > 0.0
    assert "% of the variance of the tool's point comes from the " in shown.out


@pytest.fixture
def ledger(objects: Path) -> Iterator[Ledger]:
    """That of the cell of ``objects``, beside its daemon's."""
    state = Path(load_config(objects).cell.state_dir)
    state.mkdir(parents=True, exist_ok=True)
    found = Ledger(state / "ledger.sqlite")
    yield found
    found.close()


def use_kinematics(path: Path) -> None:
    path.write_text(path.read_text().replace("[robot]", "[robot]\nuse_kinematics = true", 1))


def test_it_says_which_model_of_the_arm_will_be_used(
    subject: CommandLine, objects: Path, ledger: Ledger
) -> None:
    value = {"robot": {"model": "ur10e"}, "controller": {"model": "ur10e"}, "payload_kg": 1.2}
    assert (
        "arm: moves and poses go by the controller's own kinematics\n" in subject("check", "-c", objects).out
    )
    waits = ledger.propose("kinematics.arm", value, {}, 0, None)
    camera = ledger.propose("T_flange_camera", [0.0] * 6, {}, 0, None)
    ledger.accept(camera, "test")

    use_kinematics(objects)
    done = subject("check", "-c", objects)
    assert done.code == 0
    assert "no version of kinematics.arm is accepted: jobs that use the arm are refused" in done.err
    assert f"'cellward accept {waits}' puts the one that waits into effect" in done.err

    ledger.accept(waits, "test")
    done = subject("check", "-c", objects)
    assert "arm: moves and poses go by kinematics.arm version 1\n" in done.out
    assert "Warning: arm: T_flange_camera version 1 was made with the controller's own kinematics" in done.err

    objects.write_text(objects.read_text().replace("use_kinematics = true", "use_kinematics = false"))
    done = subject("check", "-c", objects, "--json")
    found = json.loads(done.out)["arm"]
    assert found["model"] == {"name": "controller"}
    assert "kinematics.arm version 1 is accepted and not used" in found["text"]
    assert found["cautions"] == []


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ({"controller": {"model": "ur5e"}}, "the kinematics in effect are of another arm"),
        ({"payload_kg": 4.0}, "the kinematics in effect were measured with 4 kg"),
        (
            {"serials": {"arm": "9999-7"}},
            "the kinematics in effect were measured with arm 9999-7, and this is arm 99991100001",
        ),
    ],
)
def test_it_warns_of_accepted_kinematics_that_are_not_of_this_arm(
    subject: CommandLine, objects: Path, ledger: Ledger, value: dict[str, object], told: str
) -> None:
    ledger.accept(
        ledger.propose("kinematics.arm", {"robot": {"model": "ur10e"}, **value}, {}, 0, None), "test"
    )
    use_kinematics(objects)
    text = objects.read_text()
    if "expect_serial" not in text:
        objects.write_text(text.replace("[device.arm]", '[device.arm]\nexpect_serial = "99991100001"', 1))
    assert f"Warning: arm: {told}" in subject("check", "-c", objects).err


def test_accepted_kinematics_are_held_against_the_load_of_each_tool(
    subject: CommandLine, objects: Path, ledger: Ledger
) -> None:
    value = {"robot": {"model": "ur10e"}, "payload_kg": load_config(objects).robot.payload_kg}
    ledger.accept(ledger.propose("kinematics.arm", value, {}, 0, None), "test")
    use_kinematics(objects)
    pose = "T_flange_tool = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]"
    with objects.open("a") as file:
        file.write(f"\n[tool.as-before]\n{pose}\n\n[tool.heavy]\n{pose}\npayload_kg = 3.0\n")
    told = [line for line in subject("check", "-c", objects).err.splitlines() if "were measured with" in line]
    assert len(told) == 1
    assert told[0].endswith("[tool.heavy] payload_kg is 3 kg")


def test_the_switch_without_an_arm_is_a_mistake(subject: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "armless.toml"
    path.write_text("schema = 1\n[robot]\nuse_kinematics = true\n")
    done = subject("check", "-c", path)
    assert done.code == 2
    assert "robot.use_kinematics: there is no arm whose kinematics could be used" in done.err


@pytest.fixture
def beams(tmp_path: Path) -> Path:
    """A valid configuration of the cell with crossed beams and without a camera."""
    write_config(tmp_path, "laser:ideal", jobs={"laser-reference": {"max_descents": 2, "passes": 2}})
    return tmp_path / "cell.toml"


def change(path: Path, was: str, now: str) -> None:
    text = path.read_text()
    assert was in text
    path.write_text(text.replace(was, now))


@pytest.mark.parametrize(
    ("was", "now", "told"),
    [
        ("floor_m = 0.19", "floor_m = 0.25", "no room to search: the point is 8.0 mm above the floor"),
        (
            "search_speed_m_s = 0.05",
            "search_speed_m_s = 0.4",
            "search_speed_m_s is 0.4 m/s and [limits] speed_m_s 0.25 m/s; lower the one or raise the other",
        ),
        (
            "pin_radius_m = 0.003",
            "pin_radius_m = 0.016",
            "xs.distance_m is 30 mm, and a tool 32 mm wide (by pin_radius_m) with lead_m of 4 mm on both "
            "sides needs 40 mm; make xs.distance_m longer",
        ),
        (
            "floor_m = 0.19",
            "floor_m = 0.19\nmax_poll_gap_s = 0.004",
            "[device.beams] poll_period_s is 5 ms, longer than max_poll_gap_s of 4 ms, so every pass would "
            "be refused; poll more often",
        ),
        ("aux_ys = [-1.02", "aux_ys = [2.02", "'aux_ys' differ by 174.2 deg in attitude"),
        ("max = [1.3, 1.3, 1.8]", "max = [1.3, 0.46, 1.8]", "not every move is possible: xs "),
    ],
)
def test_what_a_crossed_beam_job_cannot_do_comes_first_with_its_fix_and_exit_code_2(
    subject: CommandLine, beams: Path, was: str, now: str, told: str
) -> None:
    change(beams, was, now)
    done = subject("check", "-c", beams)
    assert done.code == 2
    first = done.err.splitlines()[0]
    assert first.startswith("Error: laser-reference: ")
    assert told in done.err
    assert "jobs cannot succeed with it" in done.out


def test_problems_stand_by_themselves_in_the_json(subject: CommandLine, beams: Path) -> None:
    change(beams, "floor_m = 0.19", "floor_m = 0.25")
    done = subject("check", "-c", beams, "--json")
    assert done.code == 2
    (problem,) = json.loads(done.out)["problems"]
    assert problem.startswith("laser-reference: not every move is possible: xs 1 at 0.0 mm: no room")


@pytest.mark.parametrize(
    ("was", "now", "told"),
    [
        (
            "[job.laser-reference]",
            "[job.laser-update]\nmax_U_m = 1e-5\n[job.laser-reference]",
            "[job.laser-update] max_U_m is 0.01 mm; lower measure_speed_m_s, take more passes",
        ),
        ("floor_m = 0.19", "floor_m = 0.19\nmax_U_m = 1e-6", "[job.laser-reference] max_U_m is 0.001 mm"),
    ],
)
def test_an_uncertainty_beyond_its_limit_is_a_warning_with_its_fix(
    subject: CommandLine, beams: Path, was: str, now: str, told: str
) -> None:
    change(beams, was, now)
    done = subject("check", "-c", beams)
    assert done.code == 0, done.err
    assert "Warning: laser-reference: 95 % of the errors" in done.err
    assert told in done.err
    assert "is valid" in done.out


def test_a_tolerance_below_what_is_measured_is_a_warning_and_the_stated_odds_hold(
    subject: CommandLine, beams: Path
) -> None:
    tight = "[job.laser-check]\ntolerance_m = 2e-5\n[job.laser-update]\nfalse_alarm = 0.02\n"
    change(beams, "[job.laser-reference]", f"{tight}[job.laser-reference]")
    done = subject("check", "-c", beams)
    assert done.code == 0, done.err
    (found,) = json.loads(subject("check", "-c", beams, "--json").out)["predictions"]
    limit = f"{1e3 * found['tolerance_m']:.3f} mm"
    assert found["tolerance_m"] > 2e-5
    assert f"[job.laser-check] tolerance_m is 0.02 mm, and the tolerance may be up to {limit}: a" in done.err
    assert f"the tolerance of laser-check is usually {limit} at most" in done.out
    assert "a right frame is turned down in 1 of 50 updates at most" in done.out


def test_a_board_out_of_reach_is_predicted_with_its_reason(
    subject: CommandLine, objects: Path, tmp_path: Path
) -> None:
    path = tmp_path / "far.toml"
    path.write_text(objects.read_text().replace("max = [1.3, 1.3, 1.8]", "max = [1.3, 1.3, 0.3]"))
    done = subject("check", "-c", path)
    assert done.code == 2
    assert "Error: cone-capture: from pose 'home'" in done.err
    assert "Not enough poses can be reached" in done.err


def test_without_a_nominal_pose_there_is_no_prediction_and_that_is_said(
    subject: CommandLine, objects: Path, tmp_path: Path
) -> None:
    path = tmp_path / "plain.toml"
    lines = [line for line in objects.read_text().splitlines() if "_nominal = " not in line]
    path.write_text("\n".join(lines))
    assert "no prediction without [robot] T_flange_camera_nominal" in subject("check", "-c", path).out


def test_every_finding_is_listed_at_once_with_its_line(subject: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    text = (
        init_text()
        .replace("speed_m_s = 0.25", 'speed_m_s = "fast"')
        .replace("[limits]", "[limits]\nspeeed = 1")
    )
    path.write_text(text)
    done = subject("check", "-c", path)
    assert (done.code, done.out) == (2, "")
    assert done.err.count(f"{path}:") >= 2
    assert "speeed" in done.err
    assert "fast" in done.err


def test_the_probe_names_who_answers(subject: CommandLine, objects: Path) -> None:
    done = subject("check", "--probe", "-c", objects, "--json")
    assert done.code == 0
    found = {d["device"]: (d["answer"], d["serial"]) for d in json.loads(done.out)["devices"]}
    assert found == {
        "arm": ("ok", "99991100001"),
        "camera": ("ok", "99992200001"),
        "beams": ("ok", "99993300001"),
    }


def test_a_probe_tells_an_arm_that_accepted_kinematics_were_not_measured_with(
    subject: CommandLine, objects: Path, ledger: Ledger
) -> None:
    value = {"robot": {"model": "ur10e"}, "serials": {"arm": "20991234"}}
    ledger.accept(ledger.propose("kinematics.arm", value, {}, 0, None), "test")
    told = (
        "kinematics.arm version 1: the kinematics in effect were measured with arm 20991234, and this is arm "
        "99991100001"
    )
    done = subject("check", "--probe", "-c", objects, "--json")
    assert told in json.loads(done.out)["warnings"]
    assert done.err.count(f"Warning: {told}") == 1
    assert told not in subject("check", "-c", objects).err, "without a probe it is unknown who is there"


def test_a_probe_of_a_cell_with_an_accepted_camera_pose_says_nothing_of_kinematics(
    subject: CommandLine, objects: Path, ledger: Ledger
) -> None:
    ledger.accept(ledger.propose("T_flange_camera", [0.0] * 6, {}, 0, None), "test")
    done = subject("check", "--probe", "-c", objects, "--json")
    assert not [text for text in json.loads(done.out)["warnings"] if "kinematics" in text]


def test_a_probe_that_finds_another_device_is_refused(
    subject: CommandLine, objects: Path, tmp_path: Path
) -> None:
    path = tmp_path / "other.toml"
    path.write_text(objects.read_text().replace("99991100001", "99991100002"))
    done = subject("check", "--probe", "-c", path)
    assert done.code == 4
    assert "99991100001" in done.out


def test_a_probe_dumps_no_frames_of_what_is_not_modbus(
    objects: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.cli.probe.supervised_devices", lambda *_: [])
    library = logging.getLogger("pymodbus")
    before = library.level
    library.setLevel(logging.NOTSET)
    try:
        asyncio.run(probe_devices(load_config(objects)))
        assert not logging.getLogger("pymodbus.logging").isEnabledFor(logging.ERROR)
    finally:
        library.setLevel(before)


@pytest.mark.wire
def test_a_probe_without_devices_says_which_are_missing_with_exit_code_3(
    subject: CommandLine, tmp_path: Path, objects: Path
) -> None:
    path = tmp_path / "absent.toml"
    text = objects.read_text().replace('clock = "fakes.object:VirtualClock"\n', "")
    text = text.replace(
        f'driver = "fakes.object:ObjectArm"\nscenario = "{tmp_path}/scenario.toml"',
        'driver = "ur"\nhost = "127.0.0.11"',
    )
    text = text.replace(
        f'driver = "fakes.object:ObjectCamera"\nscenario = "{tmp_path}/scenario.toml"',
        f'driver = "oak"\nsource = "frames+unix://{tmp_path}/absent.sock"',
    )
    path.write_text(text)
    done = subject("check", "--probe", "-c", path)
    assert done.code == 3
    lines = {line.split()[0]: line for line in done.out.splitlines()}
    assert "127.0.0.11" in lines["arm"]
    assert "absent.sock" in lines["camera"]


def test_a_file_with_findings_gives_them_as_json_on_stdout_with_exit_code_2(
    subject: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(init_text().replace("payload_kg = 1.2", "payload_kg = 45.0"))
    done = subject("check", "-c", path, "--json")
    shown = json.loads(done.out)
    assert done.code == 2
    assert (shown["valid"], shown["error"]["code"]) == (False, 4001)
    (found,) = shown["findings"]
    assert (found["key"], path.read_text().splitlines()[found["line"] - 1][:10]) == (
        "robot.payload_kg",
        "payload_kg",
    )
    path.write_text("schema = = 1")
    done = subject("check", "-c", path, "--json")
    assert (done.code, len(json.loads(done.out)["findings"])) == (2, 1)


def test_a_file_that_is_missing_is_json_as_well(subject: CommandLine, tmp_path: Path) -> None:
    done = subject("check", "-c", tmp_path / "absent.toml", "--json")
    shown = json.loads(done.out)
    assert (done.code, shown["valid"], shown["error"]["name"]) == (2, False, "FILE_MISSING")


def test_a_ledger_that_this_user_may_not_read_keeps_no_file_from_being_checked(
    subject: CommandLine, beams: Path
) -> None:
    state = Path(load_config(beams).cell.state_dir)
    state.mkdir(exist_ok=True)
    state.chmod(0)
    with without_override():
        done = subject("check", "-c", beams)
    state.chmod(0o755)
    assert done.code == 0, done.err
    assert "what is accepted is not known: This user may not use" in done.out
    assert "laser-reference" in done.out


def test_a_limit_of_acceptance_below_the_prediction_cannot_be_passed(
    subject: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(init_text().replace("max_error_t_m = 0.0005", "max_error_t_m = 0.00001"))
    done = subject("check", "-c", path)
    assert done.code == 2
    assert "accept.max_error_t_m = 1e-05 m is below the predicted 95 % error of 0.00016 m" in done.err
    assert "no number of placements gets there" in done.err


def test_a_job_without_its_camera_ends_with_exit_code_2(subject: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(
        init_text().replace('flange_camera = "camera"', "").replace("[device.camera]", "[device.c]")
    )
    done = subject("check", "-c", path)
    assert done.code == 2
    assert "job.cone-capture: the job needs a camera as 'flange_camera'" in done.err


def test_a_disk_that_is_nearly_full_is_warned_of_with_the_command_that_helps(
    subject: CommandLine, objects: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = subject("check", "-c", objects)
    monkeypatch.setattr(machine, "low_limit", lambda _: 10**18)
    full = subject("check", "-c", objects)
    assert (room.code, full.code) == (0, 0)
    assert "cellward prune" not in room.err
    assert "cellward prune" in full.err


def test_a_recording_of_a_probe_is_a_folder_that_can_be_read(
    subject: CommandLine, objects: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.cli.probe.RECORDED_S", 0.0)
    folder = tmp_path / "new" / "recording"
    assert subject("check", "--probe", "--record", folder, "-c", objects).code == 0
    assert read_recording(folder).connections == []  # the twin's objects have no wires
    again = subject("check", "--probe", "--record", folder, "-c", objects)
    assert again.code == 2
    assert f"{folder} holds a recording already" in again.err


def test_a_recording_without_a_probe_is_refused(subject: CommandLine, objects: Path, tmp_path: Path) -> None:
    done = subject("check", "--record", tmp_path / "recording", "-c", objects)
    assert done.code == 2
    assert "--record writes down what --probe does" in done.err


def test_a_clause_is_broken_where_the_terminal_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "one clause that goes on and on beyond the width of it; another"
    assert _clauses("job", text) == f"job:\n  {text.split('; ')[0]}\n  another"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "50")
    lines = _clauses("job", text).splitlines()
    assert max(map(len, lines)) <= 50
    assert [line for line in lines if line.startswith("  another")]
    assert len(lines) == 4
