"""A test of pose accuracy beside the truth of the twin in which it was made."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from daemon.config import load_config
from daemon.demo.ending import beside_truth
from daemon.rehearsal.play import RehearsedRun, rehearse
from procedures.beside_truth import Judged
from procedures.documents import read_result
from procedures.iso9283.result import Iso9283Result
from procedures.iso9283.truth import judge_iso9283
from procedures.words import mm
from tests.kit.example_cell import LASER_TRACKER, whole_example

SHORT = {"[job.iso9283]": "[job.iso9283]\ncycles = 8"}


class Run:
    """The run, what the twin knows, and where its data set is."""

    outcome: RehearsedRun
    found: Iso9283Result
    truth: Mapping[str, Any]
    folder: Path

    def judged(self, pose: str = "", **changed: Any) -> Judged:
        """With fields of one pose of the result changed."""
        poses = [p.model_copy(update=changed) if p.name == pose else p for p in self.found.result.poses]
        answer = self.found.result.model_copy(update={"poses": poses})
        return judge_iso9283(self.found.model_copy(update={"result": answer}), self.truth, self.folder)


@pytest.fixture
def subject(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    run = Run()

    def judge(result: Mapping[str, Any], truth: Mapping[str, Any], folder: Path) -> Judged:
        found = read_result(result)
        assert isinstance(found, Iso9283Result)
        run.found, run.truth, run.folder = found, truth, folder
        return beside_truth(result, truth, folder)

    monkeypatch.setattr("daemon.rehearsal.play.beside_truth", judge)
    path = whole_example(tmp_path, LASER_TRACKER | SHORT)
    run.outcome = rehearse(load_config(path), path, "iso9283", 1, tmp_path)
    return run


def test_accuracy_and_repeatability_of_a_rehearsal_agree_with_the_truth_and_false_ones_do_not(
    subject: Run,
) -> None:
    outcome = subject.outcome
    assert outcome.ended == "complete", outcome.why
    assert (outcome.good, outcome.inside95) == (True, True)
    assert set(outcome.of95) == {"the worst AP", "the worst RP"}
    assert "deviation" in outcome.off
    assert {name: unit for name, (_, unit) in outcome.limits95.items()} == {
        "the worst AP": "m",
        "the worst RP": "1",
    }
    off_m = outcome.of95["the worst AP"] * outcome.limits95["the worst AP"][0]
    assert mm(off_m) in outcome.off

    second = next(p for p in subject.found.result.poses if p.name == "P2")
    shifted = [d + 2.0 * second.AP_U for d in second.deviation]
    for wrong, figure in (
        (subject.judged("P2", deviation=shifted), "the worst AP"),
        (subject.judged("P2", RP_95=[3.0 * second.RP, 4.0 * second.RP]), "the worst RP"),
    ):
        assert not wrong.good
        assert wrong.inside95 is False
        assert wrong.of95[figure] > 1.0
        assert "NOT consistent" in wrong.text

    without = subject.judged("P2", RP_95=None)  # of too few arrivals
    assert without.good
