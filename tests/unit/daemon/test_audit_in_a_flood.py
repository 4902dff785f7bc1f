"""The audit under a flood of refused writes: accepted ones are kept, and it does not grow without end."""

import asyncio
import time
from pathlib import Path

import pytest

from cell.store.ledger import Ledger
from daemon.auditor import Auditor

COMMIT_S = 0.005


def test_accepted_writes_survive_a_flood_of_refused_ones_on_a_slow_disk() -> None:
    lines: list[tuple[str, str, bool, str]] = []

    def slow(*line: object) -> None:
        time.sleep(COMMIT_S)
        lines.append(line)  # type: ignore[arg-type]

    async def main() -> None:
        subject = Auditor(slow)
        subject.start()
        for i in range(1200):
            subject.note("127.0.0.9", "write 0", False, "not in [modbus] allow_clients")
            if i % 120 == 0:
                subject.note("127.0.0.1", f"command {i}", True)
            if i % 6 == 0:
                await asyncio.sleep(0.01)
        await subject.stop()

    asyncio.run(main())
    assert [what for _, what, accepted, _ in lines if accepted] == [
        f"command {i}" for i in range(0, 1200, 120)
    ]
    gathered = [line for line in lines if "refused writes" in line[1]]
    alone = [line for line in lines if line[1] == "write 0"]
    assert len(alone) + sum(int(line[1].split()[0]) for line in gathered) == 1200
    assert len(lines) < 60
    assert all("first 20" in line[3] and "last 20" in line[3] for line in gathered)


def test_the_audit_keeps_the_newest_refusals_and_every_accepted_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cell.store.records.MAX_AUDIT_REFUSED", 10)
    monkeypatch.setattr("cell.store.records.ROTATE_EVERY", 20)
    subject = Ledger(tmp_path / "ledger.sqlite")
    for i in range(100):
        subject.audit("modbus", "127.0.0.9", f"write {i}", i % 10 == 0)
    lines = subject.audit_lines(1000)
    subject.close()
    assert [line["what"] for line in lines if line["accepted"]] == [f"write {i}" for i in range(90, -1, -10)]
    refused = [line["what"] for line in lines if not line["accepted"]]
    assert refused[0] == "write 99"
    assert len(refused) == 10
