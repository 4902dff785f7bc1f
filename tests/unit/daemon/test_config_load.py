"""``cell.toml``: everything wrong with it at once, each with its line, and what a right one means."""

import json
import pickle
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Self

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from cell.devices import DepthCamera, DigitalInputs
from cell.errors import InputError
from daemon.config import CellConfig, ConfigInvalid, DeviceSection, init_text, load_config
from daemon.config.drivers import driver_class
from daemon.config.findings import Findings
from procedures.registry import SHIPPED


class CameraConfig(BaseModel):
    """A driver's keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    address: str
    expect_serial: str | None = None
    size: tuple[int, int] = (640, 480)
    delay_s: float = Field(0.1, gt=0, le=5)


class Camera(DepthCamera):
    Config = CameraConfig
    PLAYS = (DepthCamera,)


class Inputs(DigitalInputs):
    Config = CameraConfig
    PLAYS = (DigitalInputs,)


class NoDriver:
    pass


class Limits(BaseModel):
    speed_m_s: float | None = None


class JobConfig(BaseModel):
    model_config = ConfigDict(extra="forbid")
    target: str
    start_pose: str | None = None
    placements: int = Field(3, ge=1, le=60)
    settle_s: float = 0.3
    limits: Limits | None = None


class Job:
    Config = JobConfig

    def __init__(self, config: JobConfig) -> None:
        self.config = config

    def uses(self) -> tuple[str, ...]:
        return ("flange_camera",)


DRIVERS = {
    "camera": f"{__name__}:Camera",
    "inputs": f"{__name__}:Inputs",
    "ur": "drivers.ur:UrArm",
    "gone": "no_such_module:Driver",
}
JOBS: dict[str, Any] = {"cone-capture": Job, "laser-check": Job}
GOOD = """schema = 1
[cell]
name = "bay-3"
[robot]
flange_camera = "camera"
T_flange_camera_nominal = [0, -0.08, 0.05, 0, 0, 0]
tool = { name = "gripper", T_flange_tool = [0, 0, 0.18, 0, 0, 0], radius_m = 0.03 }
[poses]
home = [0, -1.57, 1.57, -1.57, -1.57, 0]
[device.camera]
driver = "camera"
address = "usb"
size = [1280, 800]
[device.beams]
driver = "inputs"
address = "x"
[target.board]
type = "chessboard"
columns = 9
rows = 6
square_m = 0.03
[job.cone-capture]
target = "board"
start_pose = "home"
"""


def load(folder: Path, text: str) -> CellConfig:
    path = folder / "cell.toml"
    path.write_text(text)
    path.chmod(0o640)
    return load_config(path, JOBS, DRIVERS)


def findings(folder: Path, text: str) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load(folder, text)
    prefix = f"{folder / 'cell.toml'}:"
    assert all(finding.startswith(prefix) for finding in caught.value.findings)
    return [finding.removeprefix(prefix) for finding in caught.value.findings]


@pytest.fixture
def subject(tmp_path: Path) -> CellConfig:
    return load(tmp_path, GOOD)


def test_a_good_file_gives_typed_sections_with_defaults(subject: CellConfig) -> None:
    assert subject.cell.name == "bay-3"
    assert subject.modbus.bind == "127.0.0.1:5020"
    assert not subject.modbus.allow_write
    assert subject.limits.speed_m_s == 0.25
    assert subject.robot.tool.T_flange_tool[2] == 0.18
    assert subject.robot.robot_spec() == {"model": "ur10e"}
    assert subject.target["board"]["columns"] == 9
    assert subject.job_section("cone-capture") == {"target": "board", "start_pose": "home"}
    assert subject.job_section("laser-check") == {}


def test_a_role_goes_to_the_device_it_names_else_to_the_device_of_its_name(subject: CellConfig) -> None:
    assert subject.robot.roles() == {"flange_camera": "camera", "beams": "beams"}


def test_a_device_section_is_its_drivers_own_config_with_the_drivers_name(subject: CellConfig) -> None:
    section = subject.device["camera"]
    assert isinstance(section, CameraConfig)
    assert isinstance(section, DeviceSection)
    assert (section.driver, section.address, section.size) == ("camera", "usb", (1280, 800))
    assert subject.model_dump(mode="json")["device"]["camera"]["address"] == "usb"


def test_a_device_section_reaches_another_process_as_the_drivers_config(subject: CellConfig) -> None:
    copy = pickle.loads(pickle.dumps(subject.device["camera"]))
    assert type(copy) is CameraConfig
    assert copy.size == (1280, 800)


def test_the_checksum_follows_the_values_and_not_the_text(tmp_path: Path, subject: CellConfig) -> None:
    assert 0 <= subject.checksum <= 0xFFFF
    same = load(tmp_path, GOOD.replace("[cell]", "# said otherwise\n[cell]\ntwin = false"))
    assert same.checksum == subject.checksum
    other = load(tmp_path, GOOD.replace("0.18", "0.181"))
    assert other.checksum != subject.checksum


def test_optional_keys_that_came_later_leave_a_files_digest_as_it_was(
    tmp_path: Path, subject: CellConfig
) -> None:
    """As it was before ``robot.program_after`` and ``limits.joint_ranges_rad``."""
    assert subject.digest == "43665bd455703675c0d274e16713bcbc8ded91afcbe5099a0ffaa8e3af477165"
    assert subject.checksum == 28233
    ranges = load(tmp_path, f"{GOOD}[limits]\njoint_ranges_rad = {[[-3.0, 3.0]] * 6}\n")
    assert ranges.digest != subject.digest


BAD = """[cell]
nam = "bay-3"
[robot]
arm = "arms"
flange_camera = "camera"
payload_kg = "1.2"
tool = { name = "g", T_flange_tool = [0, 0, 180, 0, 0, 0], radius_mm = 30 }
model = "urr10e"
[limits]
speed_m_s = -1
workspace = [
  { min = [0, 0, 0], max = [1, 1] },
  { min = [1, 0, 0], max = [1, 1, 1] },
]
[supervisor]
loop_lag_warn_s = nan
[poses]
home = [0, -90, 90, 0, 0]
[device.camera]
driver = "camra"
[device.arm]
driver = "camera"
adress = "x"
[device.belt]
host = "x"
[device.old]
driver = "gone"
[target.board]
type = "chesboard"
[modbus]
bind = "127.0.0.1"
allow_clients = ["10.0.0.300"]
[jobs]
[job.cone-capture]
target = "bord"
start_pose = "hom"
placements = 2.5
[job.laser-chek]
"""


def test_all_findings_come_at_once_in_order_with_line_key_and_hint(tmp_path: Path) -> None:
    assert findings(tmp_path, BAD) == [
        "1: schema: is missing",
        "2: cell.nam: unknown key, did you mean 'name'?",
        "4: robot.arm: there is no [device.arms], did you mean 'arm'?",
        "6: robot.payload_kg: should be a valid number, not '1.2'",
        "7: robot.tool.T_flange_tool[2]: 180 m is probably millimetres; lengths are in metres",
        "7: robot.tool.radius_mm: unknown key, did you mean 'radius_m'?",
        "8: robot.model: there is no arm 'urr10e', did you mean 'ur10e'?",
        "10: limits.speed_m_s: should be greater than or equal to 0.001, not -1",
        "12: limits.workspace[0].max: should have 3 entries, has 2",
        "13: limits.workspace[1].min: each number of 'min' must be smaller than that of 'max'",
        "16: supervisor.loop_lag_warn_s: should be a finite number of at most 1e+300 in size, not nan",
        "18: poses.home: should have 6 entries, has 5",
        "18: poses.home[1]: -90 rad is probably degrees; angles are in radians",
        "18: poses.home[2]: 90 rad is probably degrees; angles are in radians",
        "20: device.camera.driver: there is no driver 'camra', did you mean 'camera'?",
        "21: device.arm.address: is missing",
        "23: device.arm.adress: unknown key, did you mean 'address'?",
        "24: device.belt.driver: is missing",
        "27: device.old.driver: driver 'gone' cannot be loaded: No module named 'no_such_module'",
        "29: target.board.type: there is no target type 'chesboard', did you mean 'chessboard'?",
        "31: modbus.bind: an address and a port as in '127.0.0.1:5020' were expected",
        "32: modbus.allow_clients[0]: '10.0.0.300' does not appear to be an IPv4 or IPv6 network",
        "33: jobs: unknown key, did you mean 'job'?",
        "35: job.cone-capture.target: there is no [target.bord], did you mean 'board'?",
        "37: job.cone-capture.placements: should be a valid integer, not 2.5",
        "38: job.laser-chek: there is no job 'laser-chek', did you mean 'laser-check'?",
    ]


@pytest.mark.parametrize(
    ("old", "new", "finding"),
    [
        ("schema = 1", "schema = 2", "1: schema: should be 1, not 2"),
        ('name = "bay-3"', 'clock = "a.b:C"', "3: cell.clock: another clock is only"),
        ("size = [1280, 800]", 'expect_serial = "99991"', "13: device.camera.expect_serial: '99991' is"),
        (
            'name = "bay-3"\n[robot]',
            'twin = true\n[device.x]\ndriver="camera"\naddress="x"\nexpect_serial = "123"\n[robot]',
            "7: device.x.expect_serial: '123' is not a twin's",
        ),
        ("[poses]", '[http]\nbind = "x"\n[poses]', "9: http.bind: an address and a port"),
        ("[poses]", '[http]\nbind = "10.0.0.5:8420"\n[poses]', "9: http.bind: bind = \"10.0.0.5"),
        ("[poses]", '[http]\ntls_key = "/k"\n[poses]', "8: http: tls_cert and tls_key belong together"),
        (
            "[poses]",
            '[http]\nbind = "0.0.0.0:1"\ntls_key = "/k"\ntls_cert = "/c"\n[poses]',
            "9: http.bind: with every address in bind, 'names' lists",
        ),
        (
            "[poses]",
            '[http.user.anna]\nrole = "boss"\ntoken_sha256 = "x"\n[poses]',
            "10: http.user.anna.token_sha256: ",
        ),
        ("[poses]", '[can]\nbus = "vcan0"\n[poses]', "9: can.bus: bus 'vcan0' should begin with socketcan:"),
        ("[poses]", "[can]\nstatus_id = 0x77E\n[poses]", "8: can: command_id, acknowledge_id, status_id and"),
        ("[poses]", "[job.drift-check]\n[poses]", "8: job.drift-check: the job 'drift-check' is not"),
        ('flange_camera = "camera"', 'flange_camera = "beams"', "5: robot.flange_camera: the role 'flange_"),
        ('flange_camera = "camera"', 'gripper = "camera"', "5: robot.gripper: the role 'gripper' needs"),
        ("[device.beams]", "[device.belt]", "14: device.belt: the role 'belt' needs an encoder"),
        ("[poses]", '[modbus]\nbind = "plc:502"\n[poses]', "9: modbus.bind: 'plc' does not appear to be"),
        ("[poses]", '[modbus]\nbind = "[::1]:70000"\n[poses]', "9: modbus.bind: an address and a port"),
        ('name = "bay-3"', 'state_dir = "var"', "3: cell.state_dir: an absolute path was expected"),
        ('name = "bay-3"', f'control_socket = "/{"x" * 107}"', "3: cell.control_socket: a socket's path has"),
        ("square_m = 0.03", "square_m = 30", "21: target.board.square_m: 30 m is probably millimetres"),
        ('driver = "camera"\naddress = "usb"', 'driver = 3\naddress = "usb"', "11: device.camera.driver"),
        ('driver = "camera"', f'driver = "{__name__}:NoDriver"', "11: device.camera.driver: driver"),
        ("columns = 9", "columns = 2", "19: target.board.columns: is 2, and a chessboard needs 3 inner"),
        ('target = "board"', "", "22: job.cone-capture.target: is missing"),
        ("[target.board]", "[target]\nboard = 3\n[target.b]", "18: target.board: should be a ta"),
        ("[robot]", '[robot]\nmodel = "own.json"', "5: robot.model:"),
    ],
)  # fmt: skip
def test_one_mistake_is_one_finding_at_its_line(tmp_path: Path, old: str, new: str, finding: str) -> None:
    found = findings(tmp_path, GOOD.replace(old, new, 1))
    assert any(line.startswith(finding) for line in found), found


def test_the_error_carries_code_and_findings_through_a_process(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, BAD)
    copy = pickle.loads(pickle.dumps(caught.value))
    assert (copy.name, copy.code, copy.findings) == ("CONFIG_INVALID", 4001, caught.value.findings)
    assert "26 findings" in str(copy)


def test_text_that_is_not_toml_and_files_that_are_not_there_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match=r"not TOML.*line 1") as caught:
        load(tmp_path, "schema = = 1")
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="cellward init") as missing:
        load_config(tmp_path / "absent.toml", JOBS, DRIVERS)
    assert missing.value.name == "FILE_MISSING"
    for text in (
        f"schema = {'1' * 5000}",
        f"schema = {'[' * 900}{']' * 900}",
        f"schema = {'[' * 200}1{']' * 200}",
    ):
        with pytest.raises(ConfigInvalid) as odd:
            load(tmp_path, text)
        assert odd.value.findings
    assert "1: schema: should be a finite number" in findings(tmp_path, f"schema = {'9' * 400}")[0]
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not UTF-8") as binary:
        load_config(tmp_path / "binary.toml", JOBS, DRIVERS)
    assert binary.value.name == "FILE_UNREADABLE"


def test_what_is_allowed_but_hardly_meant_is_a_warning(tmp_path: Path) -> None:
    text = GOOD.replace("[poses]", "[modbus]\nallow_write = true\n[limits]\nspeed_m_s = 0.2\n[poses]")
    text += "limits = { speed_m_s = 1.0 }\n"
    subject = load(tmp_path, text)
    words = [warning.split(":", 1)[1] for warning in subject.warnings]
    assert words == [
        "9: modbus.allow_write: allow_clients is empty, so no client can write",
        "29: job.cone-capture.limits.speed_m_s: 1 is above 0.2 of [limits], and allow_job_override is false",
    ]
    (tmp_path / "cell.toml").chmod(0o666)
    assert "everybody may write" in load_config(tmp_path / "cell.toml", JOBS, DRIVERS).warnings[0]


def test_an_arm_without_a_workspace_is_refused_before_a_lease_would_be(tmp_path: Path) -> None:
    text = GOOD.replace("[poses]", '[device.arm]\ndriver = "ur"\nhost = "x"\n[poses]')
    with pytest.raises(ConfigInvalid, match="an arm needs one box at least"):
        load(tmp_path, text)
    load(
        tmp_path,
        text.replace("[poses]", "[limits]\nworkspace = [{ min = [-1, -1, 0], max = [1, 1, 1] }]\n[poses]"),
    )


def test_the_robots_own_parameters_are_read_from_beside_the_config(tmp_path: Path) -> None:
    (tmp_path / "own.json").write_text('{"model": "ur10e", "calibration": {"delta_a": [0, 0, 0, 0, 0, 0]}}')
    subject = load(tmp_path, GOOD.replace("[robot]", '[robot]\nmodel = "own.json"'))
    assert "calibration" in subject.robot.robot_spec()


PALLETIZER = {
    "family": "palletizer4",
    "parameters": {
        name: 1.0
        for group, of in {"a": "12345", "d": "15", "k": "1235", "t": "1235xyz"}.items()
        for name in (group + letter for letter in of)
    },
}


def with_observed(robot: Any, model: str = "palletizer.json", joints: int = 4) -> str:
    rows = ", ".join(f"{{ address = {2 * i} }}" for i in range(joints))
    return GOOD.replace("[robot]", f'[robot]\nobserved_model = "{model}"') + (
        '[device.observed_arm]\ndriver = "drivers.observed_arm:ObservedArmReader"\n'
        f'url = "tcp://127.0.0.1:502"\njoints = [{rows}]\n'
    )


def test_the_observed_arms_model_is_read_from_beside_the_config(tmp_path: Path) -> None:
    assert load(tmp_path, GOOD).robot.observed_robot_spec() is None
    (tmp_path / "palletizer.json").write_text(json.dumps(PALLETIZER))
    subject = load(tmp_path, with_observed(PALLETIZER))
    assert subject.robot.observed_robot_spec() == PALLETIZER
    assert subject.robot.roles()["observed_arm"] == "observed_arm"
    named = load(tmp_path, with_observed(None, "ur5e", 6))
    assert named.robot.observed_robot_spec() == {"model": "ur5e"}


@pytest.mark.parametrize(
    ("robot", "model", "joints", "finding"),
    [
        (None, "palletizer.json", 4, "palletizer.json"),
        (None, "ur55e", 6, "there is no arm 'ur55e', did you mean 'ur5e'?"),
        ({"links": []}, "palletizer.json", 4, "is no ROBOT: it has neither 'model' nor 'family'"),
        ({"family": "palletiser4"}, "palletizer.json", 4, "did you mean 'palletizer4'?"),
        (PALLETIZER | {"parameters": {"a1": 1.0}}, "palletizer.json", 4, "is missing"),
        (PALLETIZER, "palletizer.json", 3, "observed_arm.joints: reads 3 joints, but palletizer.json has 4"),
    ],
)
def test_a_wrong_model_of_the_observed_arm_is_a_finding(
    tmp_path: Path, robot: Any, model: str, joints: int, finding: str
) -> None:
    if robot is not None:
        (tmp_path / "palletizer.json").write_text(json.dumps(robot))
    found = findings(tmp_path, with_observed(robot, model, joints))
    assert any(finding in line for line in found), found


@st.composite
def damaged(draw: st.DrawFn) -> str:
    """The good file with a few lines lost, doubled, or given other values."""
    lines = GOOD.splitlines()
    values = ["1", "-1", "nan", "1e99", '"text"', "[]", "{}", "true", "[[1, 2]]", "1979-05-27", "[{ a = 1 }]"]
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(lines) - 1))
        key = lines[at].partition("=")[0] if "=" in lines[at] else "other "
        lines[at : at + 1] = draw(
            st.sampled_from(
                [[], [lines[at]] * 2, [f"{key}= {draw(st.sampled_from(values))}"], ["[robot]"], ["[x.y]"]]
            )
        )
    return "\n".join(lines)


@given(damaged())
@settings(max_examples=150, deadline=None)
def test_no_damage_to_a_file_gives_anything_but_findings(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    with suppress(ConfigInvalid):
        subject = load(tmp_path_factory.mktemp("damaged"), text)
        assert 0 <= subject.checksum <= 0xFFFF


class Example:
    """Where the shipped example is."""

    FILE: ClassVar[Path] = Path(__file__).parents[3] / "deploy" / "cell.toml"


def test_the_shipped_example_is_what_init_writes_and_is_valid(tmp_path: Path) -> None:
    assert Example.FILE.read_text("utf-8") == init_text()
    subject = load_config(Example.FILE)
    assert subject.robot.roles() == {"arm": "arm", "flange_camera": "camera"}
    assert not subject.cell.twin
    assert [warning for warning in subject.warnings if "everybody" not in warning] == []


def test_everything_that_is_commented_out_in_the_example_is_valid_too(tmp_path: Path) -> None:
    text = Example.FILE.read_text("utf-8")
    key = r"(\[+[\w.-]+\]|[A-Za-z_]\w* = )"
    uncommented = re.sub(rf"(?m)^# (?={key})", "", text)
    assert uncommented.count("[device.") > 2 * text.count("\n[device.")
    nominal = {"a1": 0.3, "a2": 1.15, "a3": 1.2, "a4": 0.25, "a5": 0.0, "d1": 0.78, "d5": -0.28}
    ratios = {"k1": 1.0, "k2": 1.0, "k3": 1.0, "k5": -1.0, "t1": 0.0, "t2": 0.0, "t3": 0.0, "t5": 0.0}
    parameters = {**nominal, **ratios, "tx": 0.12, "ty": 0.05, "tz": -0.06}
    robot = {"family": "palletizer4", "parameters": parameters}
    (tmp_path / "palletizer.json").write_text(json.dumps(robot), "utf-8")
    path = tmp_path / "cell.toml"
    path.write_text(uncommented, "utf-8")
    path.chmod(0o600)
    subject = load_config(path)
    roles = ("arm", "flange_camera", "beams", "tracker", "observed_arm", "belt", "gripper", "fixed_camera")
    assert set(subject.robot.roles()) == set(roles)
    # Those that go by the section of another job, or by an arm whose sampling the example does not have.
    without = {"laser-check", "laser-update", "corrected-targets"}
    assert set(subject.job) == set(SHIPPED) - without


def test_a_key_that_is_missing_is_not_said_of_another_whose_name_the_sentence_has() -> None:
    class Sampling(BaseModel):
        arm: str = "arm"

        @model_validator(mode="after")
        def _complete(self) -> Self:
            raise ValueError("joint_ranges_rad is missing; an arm that is observed has no known limits")

    subject = Findings("cell.toml")
    data = {"arm": "observed_arm"}
    with pytest.raises(ValidationError) as refused:
        Sampling.model_validate(data)
    subject.add_validation(("job", "x"), data, Sampling, refused.value)
    assert [text.split(": ")[1] for text in subject.plain] == ["job.x"]


def test_a_driver_whose_module_fails_while_it_is_imported_is_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "acme_broken.py").write_text("raise RuntimeError('no licence for this sensor')\n", "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(LookupError, match="cannot be loaded: no licence for this sensor"):
        driver_class("acme_broken:Sensor")


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 1000 + " = 1",
        "a" + ".a" * 50_000 + " = 1",
        "[" + "a." * 40 + "a]\nb = 1",
        "a = " + "{ b = " * 40 + "1" + " }" * 40,
        "a = " + "[" * 60 + "]" * 60,
    ],
)
def test_a_file_that_is_nested_too_deeply_is_refused_at_once(text: str, tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(text + "\n", "utf-8")
    with pytest.raises(ConfigInvalid, match="nested too deeply"):
        load_config(path)
