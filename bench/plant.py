"""What it takes to tell one broker of a plant: the cells' publishers, and a real Mosquitto.

``python -m bench.plant [CELLS [SECONDS]]`` prints a table. The publishers are those of the daemon, each with
a store of its own and an engine that is played; all share one process with the subscriber, so what a cell
takes is a little less than the table says. Each has runs that waited for the broker; then its state changes
once a second, as while a job runs; then nothing changes. The last line scales that to 10 000 cells.
"""

import asyncio
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import aiomqtt
import psutil

from cell.clock import MonotonicClock
from cell.store.runs import RunFolder
from daemon.config.mqtt_section import MqttSection
from daemon.mqtt.publisher import Publisher
from procedures.words import table

WAITING = 5  # runs a cell
PLANT = 10_000
TOPIC = "plant"


class PlayedEngine:
    """What a publisher reads of a daemon: ten devices, and a job that goes on step by step."""

    def __init__(self, cell: str) -> None:
        self.active, self.step = False, 0
        self._cell = cell
        self._listeners: list[Callable[[], None]] = []

    def status(self) -> dict[str, Any]:
        return {
            "cell": self._cell, "twin": True, "packml": "EXECUTE", "job": "cone-capture", "tool": None,
            "run_id": 7, "state": "capture", "step": self.step, "steps": 60, "latched": False, "prompt": None,
            "error": None, "waiting": [], "devices": {f"device{i}": {"state": "READY"} for i in range(10)},
        }  # fmt: skip

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def go_on(self) -> None:
        self.step += 1
        for listener in self._listeners:
            listener()


@dataclass
class Taken:
    """Processor time (s) and messages between two looks."""

    cells: float
    broker: float
    messages: int
    seconds: float


class Meter:
    """Looks at this process, the broker, and what a subscriber of everything has got."""

    def __init__(self, broker: psutil.Process) -> None:
        self._broker = broker
        self.heard: dict[str, int] = {}
        self._more = asyncio.Condition()
        self._last = self._now()

    def _now(self) -> tuple[float, float, int, float]:
        of_broker = self._broker.cpu_times()
        return (
            time.process_time(),
            of_broker.user + of_broker.system,
            sum(self.heard.values()),
            time.monotonic(),
        )

    def take(self) -> Taken:
        before, self._last = self._last, self._now()
        cells, broker, messages, seconds = (b - a for a, b in zip(before, self._last, strict=True))
        return Taken(cells, broker, int(messages), seconds)

    async def have_heard(self, kind: str, count: int) -> None:
        async with self._more:
            await self._more.wait_for(lambda: self.heard.get(kind, 0) >= count)

    async def listen(self, port: int) -> None:
        """Counts what the broker passes on, by the kind of message."""
        async with aiomqtt.Client("127.0.0.1", port) as client:
            await client.subscribe(f"{TOPIC}/#", qos=1)
            async for message in client.messages:
                kind = message.topic.value.rpartition("/")[2]
                self.heard[kind] = self.heard.get(kind, 0) + 1
                async with self._more:
                    self._more.notify_all()


def make_store(state: Path) -> None:
    for run_id in range(1, WAITING + 1):
        run = RunFolder.create(state / "runs", "laser-check", run_id, {}, MonotonicClock())
        run.finish({"outcome": "complete", "packml": "COMPLETE", "verdict": "pass", "error": None})


async def measure(folder: Path, port: int, broker: psutil.Process, cells: int, seconds: float) -> None:
    meter = Meter(broker)
    listener = asyncio.create_task(meter.listen(port))
    await asyncio.sleep(1.0)
    memory, of_broker = psutil.Process().memory_info().rss, broker.memory_info().rss
    engines = [PlayedEngine(f"cell-{i:04d}") for i in range(cells)]
    section = MqttSection(enabled=True, port=port, topic=TOPIC)
    meter.take()
    tasks = [
        asyncio.create_task(Publisher(section, engine, f"cell-{i:04d}", folder / str(i)).run())
        for i, engine in enumerate(engines)
    ]
    rows = []
    await meter.have_heard("run", WAITING * cells)
    rows.append((f"{WAITING} runs each that waited", meter.take()))
    memory = (psutil.Process().memory_info().rss - memory) // cells
    for name, changes in (("a state a second", True), ("nothing changes", False)):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if changes:
                for engine in engines:
                    engine.go_on()
            await asyncio.sleep(1.0)
        rows.append((name, meter.take()))
    of_broker = (broker.memory_info().rss - of_broker) // cells
    for task in (*tasks, listener):
        task.cancel()
    await asyncio.gather(*tasks, listener, return_exceptions=True)
    report(cells, rows, memory, of_broker, meter.heard["run"])


def report(cells: int, rows: list[tuple[str, Taken]], memory: int, of_broker: int, runs: int) -> None:
    lines = [
        (
            name,
            f"{taken.seconds:.1f} s",
            f"{taken.messages / taken.seconds:.0f} /s",
            f"{1e3 * taken.cells / taken.seconds / cells:.2f} ms/s",
            f"{1e3 * taken.broker / taken.seconds / cells:.3f} ms/s",
        )
        for name, taken in rows
    ]
    print(f"{cells} cells, one broker, one subscriber; {runs} of {WAITING * cells} runs arrived")
    print(table(("", "took", "messages", "a cell's publisher", "broker, a cell"), lines))
    print(f"memory: {memory / 1024:.0f} kB a publisher, {of_broker / 1024:.1f} kB a cell in the broker")
    busy = rows[1][1]
    rate, share = (x / busy.seconds / cells * PLANT for x in (busy.messages, busy.broker))
    print(
        f"on paper, {PLANT} cells that all run a job: {rate:.0f} messages/s, {share:.1f} processors and "
        f"{of_broker * PLANT / 2**20:.0f} MB of the broker"
    )


def main(cells: int, seconds: float) -> int:
    mosquitto = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if mosquitto is None:
        print("mosquitto is not installed: apt-get install mosquitto", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for i in range(cells):
            make_store(folder / str(i))
        with closing(socket.create_server(("127.0.0.1", 0))) as free:
            port = free.getsockname()[1]
        config = folder / "mosquitto.conf"
        config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
        process = subprocess.Popen([mosquitto, "-c", os.fspath(config)], stderr=subprocess.DEVNULL)
        try:
            wait_for(port)
            asyncio.run(measure(folder, port, psutil.Process(process.pid), cells, seconds))
        finally:
            process.terminate()
            process.wait(10.0)
    return 0


def wait_for(port: int) -> None:
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        with suppress(OSError), closing(socket.create_connection(("127.0.0.1", port), 1.0)):
            return
        time.sleep(0.05)
    raise TimeoutError("mosquitto does not listen")


if __name__ == "__main__":
    given = sys.argv[1:]
    sys.exit(main(int(given[0]) if given else 200, float(given[1]) if len(given) > 1 else 20.0))
