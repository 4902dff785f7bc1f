"""Decisions in any order, and a process that is killed: one version is in effect, and it was accepted."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from cell.errors import CellError
from cell.store.ledger import Ledger


class Versions(RuleBasedStateMachine):
    """Whatever people decide in whatever order: at most one version is in effect, and it was accepted."""

    def __init__(self) -> None:
        super().__init__()
        import tempfile

        self.folder = tempfile.TemporaryDirectory()
        self.ledger = Ledger(Path(self.folder.name) / "ledger.sqlite")
        self.ids: list[int] = []
        self.config = 0

    def teardown(self) -> None:
        self.ledger.close()
        self.folder.cleanup()

    @rule()
    def propose(self) -> None:
        self.ids.append(self.ledger.propose("n", len(self.ids) + 100, {}, 1, self.config))

    @rule(data=st.data(), verb=st.sampled_from(["accept", "reject"]))
    def decide(self, data: st.DataObject, verb: str) -> None:
        if not self.ids:
            return
        result_id = data.draw(st.sampled_from(self.ids))
        before = self.ledger.result(result_id)["state"]
        refused = None
        try:
            if verb == "accept":
                self.ledger.accept(result_id, "ann")
            else:
                self.ledger.reject(result_id, "ann", "no")
        except CellError as exc:
            refused = exc.name
        assert refused in (None, "NOT_NOW")
        if refused:
            assert self.ledger.result(result_id)["state"] == before
        elif verb == "accept":
            assert self.ledger.effective("n", self.config).result_id == result_id
            assert not self.ledger.effective("n", self.config).conflict

    @rule()
    def roll_back(self) -> None:
        had = self.ledger.effective("n", self.config)
        if had.version is not None:
            self.ledger.rollback("n", "bob")
            now = self.ledger.effective("n", self.config)
            assert not now.conflict
            assert now.version is None or now.version < had.version

    @rule()
    def edit_config(self) -> None:
        self.config += 1
        now = self.ledger.effective("n", self.config)
        assert now.conflict == (now.version is not None)

    @invariant()
    def one_version_at_most_is_in_effect(self) -> None:
        committed = [r for r in self.ledger.results("n") if r["state"] == "committed"]
        assert len(committed) <= 1
        now = self.ledger.effective("n", self.config)
        assert now.value == (committed[0]["value"] if committed else self.config)


Versions.TestCase.settings = settings(max_examples=20, stateful_step_count=15, deadline=None)

TestVersions = Versions.TestCase


WRITER = """
import sys
from pathlib import Path
from cell.store import _database
from cell.store.ledger import Ledger
ledger = Ledger(Path(sys.argv[1]))
while True:
    run_id = ledger.next_run_id()
    ledger.accept(ledger.propose("n", run_id, {}, run_id, 0), "ann")
    print(run_id, flush=True)
"""


@pytest.mark.wire
def test_a_killed_process_loses_no_number_and_no_version_that_it_was_told_of(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    child = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    told = [int(child.stdout.readline()) for _ in range(20)][-1]
    os.kill(child.pid, signal.SIGKILL)
    child.stdout.close()
    child.wait(10)
    again = Ledger(path)
    now = again.effective("n", 0)
    assert again.aside is None
    assert now.version is not None
    assert now.version >= told
    assert now.value == now.version
    assert again.next_run_id() in (now.value + 1, now.value + 2)
    again.close()
