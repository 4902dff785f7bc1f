"""One capture judged by several versions of the cell's own arm: ``cellward solve hand-eye --kinematics``."""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.store.ledger import Ledger
from tests.kit.cli_harness import CommandLine
from tests.kit.contradictions import good
from tests.kit.object_cell import write_config

NOMINAL = {"model": "ur10e"}
LONGER = NOMINAL | {
    "calibration": {
        "delta_a": [0.0, 0.002, 0.0, 0.0, 0.0, 0.0],
        **{key: [0.0] * 6 for key in ("delta_theta", "delta_d", "delta_alpha")},
    }
}


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    """In a cell whose arm has two versions of kinematics; beside it lies a capture with joints."""
    state = Path(write_config(tmp_path).cell.state_dir)
    state.mkdir(parents=True, exist_ok=True)
    with closing(Ledger(state / "ledger.sqlite")) as ledger:
        for robot in (NOMINAL, LONGER):
            ledger.accept(ledger.propose("kinematics.arm", {"robot": robot}, {}, 0, None), "test")
    capture = good(np.random.default_rng(3), joints=True, plan="small")
    (tmp_path / "capture.json").write_text(json.dumps(capture))
    (tmp_path / "longer.json").write_text(json.dumps(LONGER))
    return CommandLine(monkeypatch, capsys, tmp_path / "cell.toml")


def test_a_version_is_the_arm_that_it_holds_whether_it_is_in_effect_or_not(
    subject: CommandLine, tmp_path: Path
) -> None:
    def solved(*words: object) -> Any:
        done = subject("solve", "hand-eye", tmp_path, "--method", "ml", "--json", *words)
        assert done.code in (0, 1), done.err
        return json.loads(done.out)["result"]["T_flange_camera"]

    first, second = solved("--kinematics", 1), solved("--kinematics", 2)
    assert second == solved("--robot", tmp_path / "longer.json")
    np.testing.assert_allclose(first, solved(), atol=1e-6)
    assert np.linalg.norm(np.subtract(first, second)) > 1e-5


def test_the_result_names_the_version(subject: CommandLine, tmp_path: Path) -> None:
    kept = tmp_path / "result.json"
    words = ("solve", "hand-eye", tmp_path, "--method", "ml", "--output", kept)
    assert "kinematics.arm version 2" in subject(*words, "--kinematics", 2).out
    assert json.loads(kept.read_text())["inputs"]["arm_model"] == {"name": "kinematics.arm", "version": 2}
    assert "kinematics.arm" not in subject(*words).out
    assert "arm_model" not in json.loads(kept.read_text())["inputs"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("hand-eye", "--kinematics", 3), "version 3 of kinematics.arm; there is 1, 2"),
        (("hand-eye", "--kinematics", 1, "--robot", "r.json"), "--robot and --kinematics both tell the arm"),
        (("laser", "--kinematics", 1), "--kinematics is for hand-eye, not for laser; leave it out"),
    ],
)
def test_what_cannot_be_taken_is_refused_in_words(
    subject: CommandLine, tmp_path: Path, words: tuple[Any, ...], told: str
) -> None:
    done = subject("solve", words[0], tmp_path, *words[1:])
    assert done.code == 2
    assert told in done.err
