"""``cellward audit`` reads the ledger, without a daemon."""

import json

import pytest

from cell.store.ledger import Ledger
from tests.kit.cli_harness import CellOnDisk, CommandLine


@pytest.fixture
def written(cell: CellOnDisk) -> None:
    cell.state.mkdir()
    ledger = Ledger(cell.state / "ledger.sqlite")
    ledger.audit("control", "anna (uid 1000)", "accept", True)
    ledger.audit("modbus", "10.0.0.7:4711", "write 100", False, "not in allow_clients")
    ledger.audit("control", "100%_x", "reset", True)
    ledger.close()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), ["accept", "write 100", "reset"]),
        (("-n", 1), ["reset"]),
        (("--channel", "modbus"), ["write 100"]),
        (("--who", "ANNA"), ["accept"]),
        (("--who", "%_"), ["reset"]),
        (("--refused",), ["write 100"]),
        (("--refused", "--channel", "control"), []),
    ],
)
@pytest.mark.usefixtures("written")
def test_the_lines_that_are_asked_for_are_listed_newest_last(
    subject: CommandLine, words: tuple[object, ...], expected: list[str]
) -> None:
    done = subject("audit", "--json", *words)
    assert done.code == 0
    assert [line["what"] for line in json.loads(done.out)] == expected


def test_a_clock_that_was_set_back_does_not_change_the_order_of_the_lines(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    runs = cell.state / "runs"
    runs.mkdir(parents=True)
    times = iter((100.0, 200.0, 50.0))
    ledger = Ledger(cell.state / "ledger.sqlite", lambda: next(times))
    for what in ("first", "second", "after the clock was set back"):
        ledger.audit("control", "anna", what, True)
    ledger.close()
    removal = {
        "at": 150.0,
        "who": "ben",
        "run_id": 1,
        "job": "latency",
        "bytes": 1,
        "pictures": 0,
        "why": "old",
    }
    (runs / "pruned.jsonl").write_text(json.dumps({"schema": "cellward.pruned/1", **removal}) + "\n")
    told = [line["what"] for line in json.loads(subject("audit", "--json").out)]
    assert told == ["first", "second", "after the clock was set back", "remove the folder of run 1 (latency)"]
    for number in (1, 2, 3):
        newest = json.loads(subject("audit", "-n", number, "--json").out)
        assert [line["what"] for line in newest] == told[-number:]


@pytest.mark.usefixtures("written")
def test_a_refused_write_is_listed_with_its_reason(subject: CommandLine) -> None:
    line = next(line for line in subject("audit").out.splitlines() if "write 100" in line)
    assert "refused" in line
    assert "not in allow_clients" in line


def test_a_cell_without_a_ledger_has_an_empty_audit(subject: CommandLine) -> None:
    done = subject("audit")
    assert (done.code, done.out) == (0, "")
    assert "no such line" in done.err
