"""A stand-in for the job engine, and a control server that runs beside a test."""

import asyncio
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from cell.errors import CellError
from cell.store.signatures import Statement
from daemon.control import ControlServer
from daemon.start_request import StartRequest


class RecordingEngine:
    """Remembers what it was asked; refuses what its test tells it to refuse."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.refuse: CellError | Exception | None = None
        self.state = "IDLE"
        self.plan: dict[str, Any] = {}
        self.listeners: list[Callable[[], None]] = []

    def status(self) -> dict[str, Any]:
        return {"packml": self.state}

    def live(self, since: Mapping[str, int]) -> dict[str, Any]:
        return {"since": dict(since)}

    def joints(self) -> dict[str, Any]:
        return {"q": [0.0] * 6, "moving": False}

    async def start(self, request: StartRequest) -> dict[str, Any]:
        await self._ask("start", request)
        return {"plan": self.plan} if request.dry_run else {"run_id": 7}

    async def _ask(self, *what: Any) -> None:
        if self.refuse is not None:
            raise self.refuse
        self.asked.append(what)

    async def confirm(self, prompt_id: int, who: str) -> None:
        await self._ask("confirm", prompt_id, who)

    async def skip(self, prompt_id: int, who: str) -> None:
        await self._ask("skip", prompt_id, who)

    async def finish(self, who: str) -> None:
        await self._ask("finish", who)

    async def abort(self, who: str) -> None:
        await self._ask("abort", who)

    async def halt(self, who: str) -> None:
        await self._ask("halt", who)

    async def pause(self, who: str) -> None:
        await self._ask("pause", who)

    async def resume(self, who: str) -> None:
        await self._ask("resume", who)

    async def reset(self, who: str) -> None:
        await self._ask("reset", who)

    @property
    def decisions(self) -> Self:
        return self

    async def accept(self, result_id: int, who: str, warned: bool = False, why: str = "") -> dict[str, Any]:
        return {"accepted": result_id, "who": who}

    async def reject(self, result_id: int, who: str, why: str) -> dict[str, Any]:
        return {"rejected": result_id, "why": why}

    async def rollback(self, name: str, who: str) -> dict[str, Any]:
        return {"rolled_back": name}

    async def sign(self, run_id: int, said: Statement, who: str) -> dict[str, Any]:
        return {"signed": run_id, "name": said.name, "who": who}

    def subscribe(self, listener: Callable[[], None], /) -> Callable[[], None]:
        self.listeners.append(listener)
        return lambda: self.listeners.remove(listener)

    def change(self, state: str) -> None:
        self.state = state
        for listener in tuple(self.listeners):
            listener()


@contextmanager
def served(path: Path, engine: RecordingEngine) -> Iterator[Callable[[Callable[[], None]], None]]:
    """A server in a thread of its own; yields a function that runs something on its loop."""
    ready, stop = threading.Event(), asyncio.Event()
    loops: list[asyncio.AbstractEventLoop] = []

    async def serve() -> None:
        server = ControlServer(path, engine)
        await server.start()
        loops.append(asyncio.get_running_loop())
        ready.set()
        await stop.wait()
        await server.stop()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert ready.wait(5)
        yield loops[0].call_soon_threadsafe
    finally:
        loops[0].call_soon_threadsafe(stop.set)
        thread.join(10)
