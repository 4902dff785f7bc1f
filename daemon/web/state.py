"""The state of the cell as every page gets it: one JSON object, of which the page is a function."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from typing import Any

from cell.packml import PackML
from daemon.engine import Engine
from daemon.recent_writes import RecentWrites

SHOWN_WRITES = 8
MOVING = {PackML.EXECUTE, PackML.STARTING, PackML.UNHOLDING, PackML.COMPLETING}


class PageState:
    """Makes the state; listens to the engine all the time, so that the pace of a run is known."""

    def __init__(self, engine: Engine, writes: RecentWrites, plc_alive: Callable[[], bool | None]) -> None:
        """``plc_alive``: None while no PLC was heard, or none can be."""
        self._engine, self._writes, self._plc_alive = engine, writes, plc_alive
        self._pace = RunPace(engine)
        self._version = version("cellward")

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """After every change of the engine, and after every write that was asked for: one that was refused
        changes nothing, and who looks at the page has to see it all the same."""
        loop = asyncio.get_running_loop()

        def written() -> None:
            with suppress(RuntimeError):  # the loop is closed: nobody looks any more
                loop.call_soon_threadsafe(listener)

        ends = self._engine.subscribe(listener), self._writes.subscribe(written)

        def end() -> None:
            for each in ends:
                each()

        return end

    def close(self) -> None:
        self._pace.close()

    def make(self) -> dict[str, Any]:
        """The engine's status without what is long, how fast the run goes, and what was asked lately."""
        status = self._engine.status()
        last = status["last_run"]
        if last is not None and last["result"] is not None:
            kept = {key: last["result"].get(key) for key in ("kind", "verdict", "reasons")}
            status["last_run"] = {**last, "result": kept}
        return {
            "version": self._version,
            "status": status,
            "pace": self._pace.told(),
            "plc": self._plc_alive(),
            "writes": self._writes.newest(SHOWN_WRITES),
        }


class RunPace:
    """How long a run goes on already, and what is left of it if every step takes as long as those so far."""

    def __init__(self, engine: Engine) -> None:
        self._engine, self._clock = engine, engine.context.clock
        self._run: int | None = None
        self._began = self._seen = 0.0
        self._moved = 0.0  # without the time in which it was held
        self._moving = False
        self.close = engine.subscribe(self._look)

    def _look(self) -> None:
        now, run = self._clock.now(), self._engine.running
        number = run.id if run is not None else None
        if number != self._run:
            self._run, self._began, self._moved = number, now, 0.0
        elif self._moving:
            self._moved += now - self._seen
        self._seen, self._moving = now, self._engine.packml in MOVING

    def told(self) -> dict[str, float | None] | None:
        """``elapsed_s``, and ``left_s`` once a few steps were taken; None while no job runs."""
        self._look()
        run = self._engine.running
        if run is None:
            return None
        left = None
        if 2 <= run.step < run.steps:
            left = self._moved / run.step * (run.steps - run.step)
        return {"elapsed_s": self._clock.now() - self._began, "left_s": left}
