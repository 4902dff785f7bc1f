"""Who gets a place at the control socket when all of them are taken."""

import asyncio
import json
import socket
from pathlib import Path

import pytest

from cell.errors import CellError
from daemon.control import MAX_CONNECTIONS, ControlServer
from daemon.control_client import ControlClient
from tests.kit.control_harness import RecordingEngine
from tests.kit.control_serving import engine, path, serving, until

__all__ = ["engine", "path"]


def test_a_halt_gets_through_when_idle_connections_hold_every_place(
    engine: RecordingEngine, path: Path
) -> None:
    def use() -> None:
        idle = [socket.socket(socket.AF_UNIX) for _ in range(MAX_CONNECTIONS)]
        try:
            for each in idle:
                each.connect(str(path))
            for verb in ("abort", "halt"):
                with ControlClient(path) as subject:
                    subject.call(verb)
        finally:
            for each in idle:
                each.close()

    serving(path, engine, use)
    assert [what[0] for what in engine.asked] == ["abort", "halt"]


def test_the_connection_that_was_silent_longest_gives_its_place_and_is_told_so(
    engine: RecordingEngine, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.control.MAX_CONNECTIONS", 3)

    def use() -> None:
        with ControlClient(path) as watcher, ControlClient(path) as silent, ControlClient(path) as talking:
            events = watcher.watch()
            next(events)
            silent.call("status")
            talking.call("status")
            with ControlClient(path) as subject:
                subject.call("halt")
                with pytest.raises(CellError, match="needed the place"):
                    silent.call("status")
                assert talking.call("status") == next(events) == {"packml": "IDLE"}

    serving(path, engine, use)
    assert [what[0] for what in engine.asked] == ["halt"]


def test_a_watcher_gives_its_place_where_all_others_watch(
    engine: RecordingEngine, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.control.MAX_CONNECTIONS", 2)

    def use() -> None:
        with ControlClient(path) as one, ControlClient(path) as two:
            watched = [one.watch(), two.watch()]
            for events in watched:
                next(events)
            with ControlClient(path) as subject:
                subject.call("halt")
            with pytest.raises(CellError, match="needed the place"):
                for _ in watched[0]:
                    pass
            assert next(watched[1]) == {"packml": "IDLE"}

    serving(path, engine, use)


def test_a_newcomer_is_refused_while_every_connection_awaits_an_answer(
    engine: RecordingEngine, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.control.MAX_CONNECTIONS", 2)

    async def scenario() -> tuple[str, bytes]:
        go_on = asyncio.Event()
        waiting: list[str] = []

        async def slow(who: str) -> None:
            waiting.append(who)
            await go_on.wait()

        monkeypatch.setattr(engine, "finish", slow)
        server = ControlServer(path, engine)
        await server.start()
        clients = [await asyncio.open_unix_connection(path) for _ in range(2)]
        for _, writer in clients:
            writer.write(b'{"id": 1, "method": "finish"}\n')
        await until(lambda: len(waiting) == 2)
        reader, writer = await asyncio.open_unix_connection(path)
        told = json.loads(await asyncio.wait_for(reader.readline(), 5))["error"]["name"]
        go_on.set()
        answer = await asyncio.wait_for(clients[0][0].readline(), 5)
        for each in (writer, *(w for _, w in clients)):
            each.close()
        await server.stop()
        return told, answer

    told, answer = asyncio.run(scenario())
    assert told == "NOT_NOW"
    assert json.loads(answer) == {"id": 1, "result": None}
