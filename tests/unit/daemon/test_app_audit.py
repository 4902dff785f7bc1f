"""The daemon's wiring: what a person does over the control socket is found in the ledger."""

import asyncio
import time
from pathlib import Path

import pytest

from cell.errors import CellError
from cell.store.ledger import Ledger
from daemon.app import serve
from daemon.config import load_config
from daemon.control_client import ControlClient
from daemon.worker import ProcessWorker


def appears(path: Path) -> None:
    end = time.monotonic() + 30.0
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.wire
def test_a_write_over_the_control_socket_is_in_the_audit_table(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    state = tmp_path / "state"
    text = f'schema = 1\n[cell]\nname = "bare"\nstate_dir = "{state}"\n'
    path.write_text(f'{text}control_socket = "{tmp_path / "control.sock"}"\n')
    path.chmod(0o600)

    def write() -> None:
        with ControlClient(tmp_path / "control.sock") as client:
            client.call("reset")
            with pytest.raises(CellError, match="no job is running"):
                client.call("pause")

    async def main() -> None:
        stop = asyncio.Event()
        daemon = asyncio.create_task(serve(load_config(path), stop, ProcessWorker()))
        async with asyncio.timeout(60.0):
            await asyncio.to_thread(appears, tmp_path / "control.sock")
            await asyncio.to_thread(write)
            stop.set()
            await daemon

    asyncio.run(main())
    ledger = Ledger(state / "ledger.sqlite")
    lines = [(line["channel"], line["what"], line["accepted"]) for line in ledger.audit_lines()]
    ledger.close()
    assert lines == [("control", "pause", False), ("control", "reset", True)]
