"""Stands in for ``cellward`` as the demo starts it: a run takes a second instead of minutes.

What it does is told by the file ``mode`` in the demo's folder: complete, beyond (an answer far from the
truth), hold (until it is resumed), abort, or die.
"""

import asyncio
import json
import signal
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from cell.clock import MonotonicClock
from cell.errors import error
from cell.store.runs import RunFolder
from daemon.config import ModbusSection
from daemon.modbus import Command, ModbusFace

STORED = Path(__file__).parents[1] / "kit" / "stored_results" / "hand-eye-01.json"
PROMPT = 0x70001
BUSY_BIT, READY_BITS = 2, 1 | 1 << 7 | 1 << 8


class Daemon:
    """One job with one prompt."""

    def __init__(self, folder: Path, bind: str) -> None:
        self.mode = (folder / "mode").read_text()
        self.truth = json.loads((folder / "truth.json").read_text())["T_flange_camera"]
        self.run = RunFolder.create(folder / "state" / "runs", "cone-capture", 7, {}, MonotonicClock())
        self.confirmed, self.resumed = asyncio.Event(), asyncio.Event()
        self.status: dict[str, Any] = {"status": READY_BITS, "packml_state": 4}
        self.job: asyncio.Task[None] | None = None
        config = ModbusSection(bind=bind, allow_write=True, allow_clients=["127.0.0.0/8"])
        self.face = ModbusFace(config, MonotonicClock(), self.handle, lambda: self.status)

    async def serve(self) -> None:
        stop = asyncio.Event()
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
        await self.face.start()
        await stop.wait()
        await self.face.stop()

    async def handle(self, command: Command) -> int:
        if command.code == 1:
            self.status = {"status": READY_BITS | BUSY_BIT, "packml_state": 6, "run_id": 7, "steps": 60}
            self.job = asyncio.create_task(self.play())
        elif command.code == 10 and command.argument_uint32 == PROMPT:
            self.confirmed.set()
        elif command.code == 6:
            self.resumed.set()
        return 1

    async def play(self) -> None:
        await asyncio.sleep(0.3)
        if self.mode == "die":
            sys.exit("the arm fell off")
        self.status = self.status | {"step": 20, "prompt_id": PROMPT}
        await self.confirmed.wait()
        self.status = self.status | {"step": 60, "prompt_id": 0}
        if self.mode == "hold":
            self.status = self.status | {"packml_state": 11}
            await self.resumed.wait()
            self.status = self.status | {"packml_state": 6}
        await asyncio.sleep(0.3)
        await asyncio.to_thread(self.write_end)
        packml = 9 if self.mode == "abort" else 17
        self.status = self.status | {"status": READY_BITS, "packml_state": packml}

    def write_end(self) -> None:
        if self.mode == "abort":
            self.run.finish({"outcome": "aborted", "error": error("BOARD_NOT_SEEN", "at pose 3").as_dict()})
            return
        off = 1e-3 if self.mode == "beyond" else 5e-5
        pose = np.array(self.truth) + np.array([off, 0, 0, 0, 0, 0])
        cov = np.diag([1e-8] * 6).tolist()
        answer = {"T_flange_camera": pose.tolist(), "cov": cov, "rejected": []}
        result = json.loads(STORED.read_text("utf-8"))
        self.run.write_result({**result, "result": {**result["result"], **answer}})
        (self.run.path / "report.html").write_text("<html>")
        self.run.finish({"outcome": "complete", "verdict": "pass", "error": None})


def daemon(words: list[str]) -> None:
    config = Path(words[words.index("--config") + 1])
    bind = tomllib.loads(config.read_text())["modbus"]["bind"]
    folder = config.parent

    async def serve() -> None:
        await Daemon(folder, bind).serve()

    asyncio.run(serve())


if __name__ == "__main__":
    daemon(sys.argv[1:])
