"""Steps that should find a fault, and the cross check of its runs: what is wrong ends it with 1."""

import json
from pathlib import Path
from typing import Any

import pytest

from cell.clock import MonotonicClock
from cell.errors import error
from cell.formats.result import Result
from cell.store.runs import RunFolder
from daemon.cli.failures import FAILED, OK
from daemon.demo import cross_checked, ending
from daemon.demo.cross_checked import Done, cross_check
from procedures.beside_truth import Judged
from procedures.cross_check.result import CrossCheckResult
from tests.kit.whole_results import STORED, made

STILL: dict[str, Any] = {
    "T_flange_tool": [0.0, 0.0, 0.18, 0.0, 0.0, 0.0],
    "mechanical": {"T_flange_camera": [0.0, -0.08, 0.05, 0.0, 0.0, 0.0]},
    "robot": {"error": {"delta_theta": [0.0] * 6}},
}
BENT = STILL | {"T_flange_tool": [0.0009, -0.0012, 0.18, 0.0, 0.0, 0.0]}
STEPS = (("cone-capture", STILL), ("laser-check", BENT), ("cone-capture", BENT), ("touch-test", BENT))


def answer(part: str, **figures: Any) -> CrossCheckResult:
    document = {"kind": "cross-check", "verdict": "fail", "result": {"part": part, "probable": {}, **figures}}
    found = made(document)
    assert isinstance(found, CrossCheckResult)
    return found


@pytest.fixture
def runs(tmp_path: Path) -> list[Done]:
    made_of = enumerate(STEPS, start=1)
    for number, (job, _) in made_of:
        RunFolder.create(tmp_path / "runs", job, number, {}, MonotonicClock())
    return [(job, tmp_path / "runs", number, truth) for number, (job, truth) in enumerate(STEPS, start=1)]


@pytest.mark.parametrize(
    ("found", "code", "told"),
    [
        (answer("tool", t=0.00149, t_sigma=2e-5), OK, "agrees with the truth"),
        (answer("tool", t=0.00119, t_sigma=2e-5), FAILED, "NOT consistent with the truth"),
        (answer("camera", t=0.001, t_sigma=2e-5, r=0.0, r_sigma=1e-5), FAILED, "NOT consistent"),
        (answer("none"), FAILED, "NOT consistent"),
        (answer("cannot-tell", probable={"tool": 0.9}), FAILED, "NOT consistent"),
        (Result(kind="cross-check", verdict="fail", reasons=["too-few-poses"], result=None), FAILED, "fail"),
        (error("DATA_INVALID", "the touch test saw nothing"), FAILED, "not done: "),
    ],
)
def test_only_the_right_part_by_the_right_amount_is_good(
    found: Any, code: int, told: str, runs: list[Done], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def check_cell(*folders: Path, touch: Path) -> Any:
        asked.extend([*folders, touch])
        if isinstance(found, Exception):
            raise found
        return found

    monkeypatch.setattr(cross_checked, "check_cell", check_cell)
    subject = cross_check(runs, tmp_path)
    assert (subject.job, subject.code) == ("cross-check", code)
    assert told in subject.verdict
    assert [folder.name.rsplit("_", 1)[1] for folder in asked] == ["1", "3", "2", "4"]


@pytest.mark.parametrize(
    ("verdict", "finds_fault", "agrees", "code"),
    [
        ("pass", False, True, OK),
        ("fail", False, True, FAILED),
        ("fail", True, True, OK),
        ("fail", True, False, FAILED),
        ("pass", True, True, FAILED),
        ("warn", True, True, FAILED),
    ],
)
def test_a_step_that_should_find_a_fault_is_good_with_a_verdict_of_fail_alone(
    verdict: str,
    finds_fault: bool,
    agrees: bool,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = RunFolder.create(tmp_path, "laser-check", 7, {}, MonotonicClock())
    stored = next(path for path in STORED if path.name == "laser-01.json")
    run.write_result(json.loads(stored.read_text("utf-8")) | {"verdict": verdict})
    run.finish({"outcome": "complete", "verdict": verdict, "error": None})
    monkeypatch.setattr(ending, "beside_truth", lambda *_: Judged(agrees, "", "0.1 mm", "0.0 mm"))
    subject = ending.conclude(tmp_path, 7, {}, finds_fault)
    assert subject.code == code
    assert ("as it should" in subject.verdict) == (verdict == "fail" and finds_fault)
