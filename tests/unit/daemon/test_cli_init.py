"""``cellward init``: what the cell has and nothing else, in a file that can be loaded."""

import itertools
import re
import tomllib
from pathlib import Path

import pytest

from daemon.cli import init
from daemon.cli.poses import with_pose
from daemon.config import init_text, load_config
from daemon.config.draft import Cell, draft
from daemon.predictions import found_in, predictions
from tests.kit.cli_harness import CellOnDisk, CommandLine

OPTIONS = {
    "camera": ("--camera",),
    "beams": ("--beams", "tcp://10.0.5.30:502"),
    "tracker": ("--tracker", "tcp://10.0.5.40:1212"),
    "belt": ("--belt", "socketcan:can1"),
    "plc": ("--plc", "10.0.5.5"),
    "page": ("--page",),
}


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    return CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)


@pytest.mark.parametrize(
    "parts", [c for n in (0, 1, 2, 6) for c in itertools.combinations(OPTIONS, n)], ids="-".join
)
def test_each_combination_is_loaded_without_a_finding(
    subject: CommandLine, tmp_path: Path, parts: tuple[str, ...]
) -> None:
    path = tmp_path / "new.toml"
    words = [word for part in parts for word in OPTIONS[part]]
    assert subject("init", "-o", path, "--name", "bay-7", "--arm", "10.0.5.20", *words).code == 0
    config = load_config(path)
    assert (config.cell.name, config.device["arm"].host) == ("bay-7", "10.0.5.20")  # type: ignore[attr-defined]
    devices = {name: {name} for name in ("camera", "beams", "tracker")}
    devices["belt"] = {"belt", "belt_camera", "gripper"}
    assert config.device.keys() == {"arm"}.union(*(devices.get(part, set()) for part in parts))
    assert config.http.enabled is ("page" in parts)
    assert config.modbus.allow_clients == (["10.0.5.5"] if "plc" in parts else [])
    assert not config.poses
    assert not config.robot.load_stated
    assert config.robot.tool.T_flange_tool == [0.0] * 6
    text = path.read_text()
    assert "20235500123" not in text.replace('# expect_serial = "20235500123"', "")
    assert "pillar" not in text


def taught(path: Path) -> None:
    """Fill in what a person teaches and measures, with the example's own values."""
    example = {line.partition(" = ")[0]: line for line in re.sub(r"(?m)^# ", "", init_text()).splitlines()}
    lines = []
    for line in path.read_text().splitlines():
        found = re.match(r"# (payload_kg|centre_of_mass_m|tool|home|wait|place)\b", line)
        lines.append(example[found[1]] if found else line)
    path.write_text("\n".join(lines))


def test_what_must_be_taught_or_measured_is_not_invented_but_named(
    subject: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "new.toml"
    subject("init", "-o", path, "--model", "ur5e", *OPTIONS["camera"], *OPTIONS["beams"])
    checked = subject("check", "-c", path)
    assert checked.code == 2
    for pose in ("home", "aux_xs", "aux_ys"):
        assert f"there is no '{pose}' in [poses]" in checked.err
        assert f"'cellward pose save {pose}'" in checked.err
    for pose in ("aux_xs", "aux_ys"):
        assert checked.err.count(f"'{pose}' in [poses]") == 1
    assert checked.err.count("[poses]") == 3, "each of the poses is named once"
    assert "robot.payload_kg: is missing, so cone-capture, laser-" in checked.err
    assert "robot.tool: is missing" in checked.err
    text = with_pose(path.read_text(), "aux_xs", [0.0, -1.57, 1.57, -1.57, -1.57, 0.0], replace=False)
    path.write_text(text)
    problems = load_config(path).problems
    assert [problem.split(": ")[1] for problem in problems] == [
        "robot.payload_kg",
        "job.cone-capture.start_pose",
        "job.laser-reference.ys.aux",
    ]


def test_what_is_drafted_for_a_belt_can_be_done_with_it(subject: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "belt.toml"
    assert subject("init", "-o", path, *OPTIONS["belt"]).code == 0
    taught(path)
    expected = predictions(load_config(path))
    assert found_in(expected, "problems") == []
    slow = [text for text in found_in(expected, "cautions") if "cannot meet an item" in text]
    assert len(slow) == 2
    assert all("raise limits of the job" in text for text in slow)
    # The place where the tool would be then is metres away, and tells nobody anything.
    assert not any("no joints for" in text for text in slow)
    assert ["no slower than the tool may be" in text for text in slow] == [False, True]


def test_a_place_that_cannot_be_reached_from_the_belt_is_not_blamed_on_the_limits(
    subject: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "belt.toml"
    subject("init", "-o", path, *OPTIONS["belt"])
    taught(path)
    path.write_text(path.read_text().replace("place = [-1.948628", "place = [1.5"))
    met = [
        text for text in found_in(predictions(load_config(path)), "cautions") if "cannot meet an item" in text
    ]
    assert len(met) == 3
    assert all("the same with a belt at rest" in text for text in met)


def test_addresses_stand_where_they_belong(subject: CommandLine) -> None:
    told = tomllib.loads(subject("init", *(word for words in OPTIONS.values() for word in words)).out)
    assert told["device"]["beams"]["url"] == "tcp://10.0.5.30:502"
    assert told["device"]["tracker"]["url"] == "tcp://10.0.5.40:1212"
    assert told["device"]["belt"]["bus"] == "socketcan:can1"
    assert told["modbus"]["allow_write"] is True


def test_a_terminal_is_asked(subject: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(["bay-9", "ur5e", "10.1.1.1", True, "", "", "socketcan:can0", "", False])

    def answer(*_: object, **__: object) -> object:
        return next(answers)

    monkeypatch.setattr(init.typer, "prompt", answer)
    monkeypatch.setattr(init.typer, "confirm", answer)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    told = tomllib.loads(subject("init").out)
    assert (told["cell"]["name"], told["robot"]["model"]) == ("bay-9", "ur5e")
    assert told["device"].keys() == {"arm", "camera", "belt", "gripper", "belt_camera"}
    assert "http" not in told


def test_what_cannot_be_meant_is_refused(subject: CommandLine) -> None:
    assert "ur99" in subject("init", "--model", "ur99").err
    assert "leave --arm out" in subject("init", "--example", "--arm", "10.0.0.1").err
    assert subject("init", "--model", "ur99").code == 2


def test_an_address_with_a_quote_stays_one_text() -> None:
    told = tomllib.loads(draft(Cell("cell", "ur10e", 'a"b\\c')))
    assert told["device"]["arm"]["host"] == 'a"b\\c'


def test_a_name_that_no_cell_may_have_is_refused(subject: CommandLine) -> None:
    assert "nothing is written: cell.name: " in subject("init", "--name", 'a"b\\c').err


@pytest.mark.parametrize(
    ("option", "value", "finding"),
    [
        ("--arm", "999.1.1", "device.arm.host: '999.1.1' is no IP address"),
        ("--beams", "192.168.3.20", "device.beams.url"),
        ("--tracker", "foo", "device.tracker.url"),
        ("--belt", "can0", "device.belt.bus"),
        ("--plc", "10.0.0.300", "modbus.allow_clients[0]"),
    ],
)
def test_an_address_that_check_would_refuse_is_refused_and_nothing_is_written(
    subject: CommandLine, tmp_path: Path, option: str, value: str, finding: str
) -> None:
    path = tmp_path / "new.toml"
    done = subject("init", "-o", path, option, value)
    assert done.code == 2
    assert finding in done.err
    assert not path.exists()


def test_the_last_line_names_all_that_has_to_be_edited(subject: CommandLine, tmp_path: Path) -> None:
    said = subject("init", "-o", tmp_path / "new.toml", *OPTIONS["camera"]).err
    for what in ("addresses", "payload", "tool", "[limits]", "nominal poses", "board", "cellward pose save"):
        assert what in said
