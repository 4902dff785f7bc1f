"""``cell.toml``: what is well formed and cannot work is found in one round, at the line of its key."""

from pathlib import Path

import cv2
import pytest

from daemon.config import ConfigInvalid, init_text, load_config
from daemon.config.targets import DICTIONARY_SIZES

BEAMS = """
[device.beams]
driver = "modbus-inputs"
url = "tcp://192.168.10.30:502"
inputs = { xs = { address = 0 }, ys = { address = 1 } }
"""


@pytest.fixture
def subject(tmp_path: Path) -> Path:
    """The commented example with a group of inputs: valid."""
    path = tmp_path / "cell.toml"
    path.write_text(init_text() + BEAMS)
    load_config(path)
    return path


def change(path: Path, was: str, now: str) -> int:
    """Replace the first ``was``; returns its line."""
    text = path.read_text()
    assert was in text, was
    path.write_text(text.replace(was, now, 1))
    return text[: text.index(was)].count("\n") + 1


def findings(path: Path) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load_config(path)
    return [sentence.removeprefix(f"{path}:") for sentence in caught.value.findings]


MISTAKES = [
    ('host = "', 'host = "10.0.0.1:30004" #', "device.arm.host: '10.0.0.1:30004' should have no port"),
    ('host = "', 'host = "192.168.1.300" #', "device.arm.host: '192.168.1.300' is no IP address"),
    ('30:502"\ninputs', '300:502"\ninputs', "device.beams.url: '192.168.10.300'"),
    (
        "payload_kg = 1.2",
        "payload_kg = 45.0",
        "robot.payload_kg: 45 kg is more than a ur10e carries (12.5 kg)",
    ),
    ("home = [0.0", "home = [7.0", "poses.home[0]: 7 rad is beyond the joint's range"),
    ('"DICT_5X5_100"', '"DICT_5x5_100"', "target.board.dictionary: OpenCV has no dictionary"),
    (
        "ys = { address = 1 }",
        "ys = { address = 0 }",
        "device.beams.inputs: inputs xs and ys have the same address 0",
    ),
    (
        "marker_m = 0.018",
        "marker_m = 0.03",
        "target.board.marker_m: 'marker_m' must be smaller than 'square_m'",
    ),
    (
        'flange_camera = "camera"',
        'flange_camera = "arm"',
        "robot.flange_camera: the role 'flange_camera' needs",
    ),
]


@pytest.mark.parametrize(("was", "now", "said"), MISTAKES, ids=[m[2].partition(":")[0] for m in MISTAKES])
def test_one_mistake_is_one_finding_at_the_line_of_its_key(
    subject: Path, was: str, now: str, said: str
) -> None:
    line = change(subject, was, now)
    (found,) = findings(subject)
    assert found.startswith(f"{line}: {said}")


def test_mistakes_of_every_group_are_found_in_one_round(subject: Path) -> None:
    mistakes = [m for m in MISTAKES if "192.168.1.300" not in m[1]]
    for was, now, _ in mistakes:
        change(subject, was, now)
    change(subject, "[device.beams]", '[device.beams]\npoll_period_s = "slow"')
    found = findings(subject)
    assert len(found) == len(mistakes) + 1
    for _, _, said in mistakes:
        assert any(said in sentence for sentence in found), said


def test_a_board_that_needs_more_markers_than_its_dictionary_has_is_refused(subject: Path) -> None:
    change(subject, "squares_x = 10", "squares_x = 100")
    change(subject, "squares_y = 7", "squares_y = 100")
    (found,) = findings(subject)
    assert "100 x 100 squares need 5000 markers, DICT_5X5_100 has 100" in found


def test_the_dictionaries_are_those_of_opencv() -> None:
    names = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    sizes = {n: len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, n)).bytesList) for n in names}
    assert sizes == DICTIONARY_SIZES


def test_the_byte_order_mark_of_windows_editors_is_accepted(subject: Path) -> None:
    plain = load_config(subject)
    subject.write_bytes(b"\xef\xbb\xbf" + subject.read_bytes())
    assert load_config(subject).checksum == plain.checksum


@pytest.mark.parametrize(
    ("role", "kind"), [("arm", "an arm that can be moved"), ("flange_camera", "a camera")]
)
def test_a_job_without_a_device_that_it_uses_is_a_problem_at_its_line(
    subject: Path, role: str, kind: str
) -> None:
    device = {"arm": "arm", "flange_camera": "camera"}[role]
    change(subject, f'{role} = "{device}"', "")
    change(subject, f"[device.{device}]", "[device.other]")
    line = subject.read_text().split("[job.cone-capture]")[0].count("\n") + 1
    (found,) = load_config(subject).problems
    assert found.startswith(
        f"{subject}:{line}: job.cone-capture: the job needs {kind} as '{role}'; add a device"
    )
