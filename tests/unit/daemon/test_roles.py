"""A role that names a device of another kind: one finding with its line and a hint, and no start."""

from pathlib import Path

import pytest

import fakes.object
from cell.devices import Arm, DepthCamera, Device, Gripper
from cell.errors import CellError
from cell.kinds import as_kind, lacking, plays
from daemon.config import ConfigInvalid, load_config
from daemon.config.drivers import DRIVERS, driver_class
from daemon.config.roles import ROLES
from tests.kit.cli_harness import CommandLine

KIND_OF_ROLE = {
    "arm": "arm", "observed_arm": "observed arm", "flange_camera": "camera", "fixed_camera": "camera",
    "beams": "inputs", "place_inputs": "inputs", "belt": "encoder", "tracker": "tracker",
    "gripper": "gripper",
}  # fmt: skip
KIND_OF_DRIVER = {
    "ur": "arm", "oak": "camera", "modbus-inputs": "inputs", "arm-inputs": "inputs", "geocom": "tracker",
    "line-stream": "tracker", "line-points": "tracker", "observed-arm": "observed arm",
    "arm-gripper": "gripper", "modbus-gripper": "gripper", "robotiq": "gripper",
    "canopen-encoder": "encoder", "raw-can-encoder": "encoder",
}  # fmt: skip
WRONG = [
    (role, driver)
    for role, kind in KIND_OF_ROLE.items()
    for driver, other in KIND_OF_DRIVER.items()
    if kind != other
]
CELL = """schema = 1
[cell]
name = "bay"
[limits]
workspace = [{ min = [-1, -1, 0], max = [1, 1, 1] }]
[device.ur]
driver = "ur"
host = "10.0.0.1"
[device.oak]
driver = "oak"
[device.modbus-inputs]
driver = "modbus-inputs"
url = "tcp://10.0.0.2:502"
inputs = { x = { address = 0 } }
[device.arm-inputs]
driver = "arm-inputs"
arm = "ur"
inputs = { x = { address = 0 } }
[device.geocom]
driver = "geocom"
url = "tcp://10.0.0.3:1212"
reflectors = { a = { constant_m = 0.0 } }
[device.line-stream]
driver = "line-stream"
url = "tcp://10.0.0.4:5000"
serial = "1"
sigma0_m = 1e-5
sigma_per_m = 1e-5
length_unit = "m"
reflectors = { a = {} }
columns = { x = 1, y = 2, z = 3 }
[device.line-points]
driver = "line-points"
url = "tcp://10.0.0.4:5001"
serial = "1"
sigma0_m = 1e-5
sigma_per_m = 1e-5
length_unit = "m"
reflectors = { a = {} }
columns = { x = 1, y = 2, z = 3 }
request = "measure\\n"
[device.observed-arm]
driver = "observed-arm"
url = "file:///var/joints.csv"
joints = [{}, {}, {}, {}]
[device.arm-gripper]
driver = "arm-gripper"
arm = "ur"
output = 0
confirm = 0
[device.modbus-gripper]
driver = "modbus-gripper"
url = "tcp://127.0.0.1:502"
output = 0
confirm = 0
serial = "1"
[device.robotiq]
driver = "robotiq"
url = "urcap://127.0.0.1:63352"
serial = "1"
[device.canopen-encoder]
driver = "canopen-encoder"
bus = "socketcan:can0"
[device.raw-can-encoder]
driver = "raw-can-encoder"
bus = "socketcan:can0"
id = 1
[robot]
"""


@pytest.fixture
def subject(tmp_path: Path) -> Path:
    """The file of a cell with a device of every driver; the last section is ``[robot]``."""
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    path.chmod(0o600)
    load_config(path)
    return path


def test_the_pairings_of_this_file_are_those_of_the_tables() -> None:
    assert set(KIND_OF_ROLE) == set(ROLES)
    assert set(KIND_OF_DRIVER) == set(DRIVERS)


@pytest.mark.parametrize(("role", "driver"), WRONG)
def test_a_role_of_another_kind_is_one_finding_with_line_and_hint(
    role: str, driver: str, subject: Path
) -> None:
    subject.write_text(CELL + f'{role} = "{driver}"\n')
    with pytest.raises(ConfigInvalid) as caught:
        load_config(subject)
    (finding,) = caught.value.findings
    place = f"{subject}:{CELL.count(chr(10)) + 1}: robot.{role}: the role '{role}' needs "
    assert finding.startswith(place)
    assert f"but [device.{driver}] is " in finding
    fitting = [d for d, kind in KIND_OF_DRIVER.items() if kind == KIND_OF_ROLE[role]]
    assert finding.endswith("; name " + " or ".join(f"[device.{name}]" for name in fitting))


@pytest.mark.parametrize(
    ("role", "driver"), [(r, d) for r in KIND_OF_ROLE for d in KIND_OF_DRIVER if (r, d) not in WRONG]
)
def test_a_role_of_the_right_kind_is_valid(role: str, driver: str, subject: Path) -> None:
    subject.write_text(CELL + f'{role} = "{driver}"\n')
    assert load_config(subject).robot.roles()[role] == driver


def test_the_hint_for_a_kind_that_the_cell_does_not_have_is_to_add_one(subject: Path) -> None:
    text = CELL.replace("[device.arm-gripper]", "[device.hand]", 1)
    start, end = text.index("[device.hand]"), text.index("[device.canopen-encoder]")
    subject.write_text(text[:start] + text[end:] + 'gripper = "oak"\n')
    with pytest.raises(ConfigInvalid, match="remove the key, or add a device of that kind and name it"):
        load_config(subject)


@pytest.mark.parametrize("words", [("check",), ("run",)])
def test_neither_check_nor_the_daemon_accepts_a_camera_as_the_arm(
    words: tuple[str, ...],
    subject: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    subject.write_text(CELL + 'arm = "oak"\n')
    ran = CommandLine(monkeypatch, capsys, subject)(*words, "--config", subject)
    assert ran.code != 0
    assert f"{subject}:{CELL.count(chr(10)) + 1}: robot.arm: the role 'arm' needs an arm" in ran.out + ran.err
    assert "Traceback" not in ran.out + ran.err


class Eye:
    name = "eye"
    PLAYS = (DepthCamera,)


def test_a_device_is_given_as_the_kind_that_it_says_it_is_and_as_no_other() -> None:
    eye: Device = Eye()  # type: ignore[assignment]
    assert as_kind(eye, DepthCamera) is eye
    with pytest.raises(CellError, match="'eye' is no Arm"):
        as_kind(eye, Arm)


def test_every_driver_has_what_its_kind_asks() -> None:
    assert {"confirms", "grip", "holding", "open"} <= set(lacking(object, Gripper))
    known = [*map(driver_class, DRIVERS), *(vars(fakes.object)[name] for name in fakes.object.__all__)]
    found = [
        (c.__name__, lacking(c, r.protocol)) for r in ROLES.values() for c in known if plays(c, r.protocol)
    ]
    assert len(found) > 20
    assert [one for one in found if one[1]] == []


def test_a_driver_of_another_version_is_a_finding_before_anything_runs(
    subject: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("drivers.ur.gripper.ArmGripper.confirms")
    subject.write_text(CELL + 'gripper = "arm-gripper"\n')
    with pytest.raises(
        ConfigInvalid, match=r"driver 'arm-gripper' lacks confirms, of cell\.devices\.Gripper"
    ):
        load_config(subject)
