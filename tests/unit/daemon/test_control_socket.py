"""The control socket and its client, on a real unix socket with a stand-in engine."""

import asyncio
import os
import socket
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError, error
from daemon.control import WATCH_PERIOD_S, ControlServer
from daemon.control_client import ControlClient
from daemon.start_request import StartRequest
from tests.kit.control_harness import RecordingEngine
from tests.kit.control_serving import engine, path, serving, until

__all__ = ["engine", "path"]


def test_every_method_reaches_the_engine_with_the_name_of_who_asked(
    engine: RecordingEngine, path: Path
) -> None:
    def use() -> list[Any]:
        with ControlClient(path) as subject:
            started = subject.call("start", job="cone-capture", params={"settle_s": "0.5"}, adopt=3)
            for verb in ("finish", "abort", "halt", "pause", "resume", "reset"):
                assert subject.call(verb) is None
            subject.call("confirm", prompt_id=65537)
            return [
                started,
                subject.call("accept", result_id=4),
                subject.call("reject", result_id=5, why="board was loose"),
                subject.call("rollback", name="T_flange_camera"),
            ]

    started, accepted, rejected, rolled_back = serving(path, engine, use)
    who = f"(uid {os.getuid()})"
    request = engine.asked[0][1]
    assert request == StartRequest("cone-capture", {"settle_s": "0.5"}, request.who, "control", adopt=3)
    assert all(who in str(call) for call in engine.asked)
    assert [call[0] for call in engine.asked[1:]] == [
        "finish", "abort", "halt", "pause", "resume", "reset", "confirm",
    ]  # fmt: skip
    assert started == {"run_id": 7}
    assert (accepted["accepted"], rejected["why"]) == (4, "board was loose")
    assert rolled_back == {"rolled_back": "T_flange_camera"}


def test_a_refusal_arrives_as_the_same_error_with_its_hint(engine: RecordingEngine, path: Path) -> None:
    engine.refuse = error("BUSY", "cone-capture, run 6")

    def use() -> CellError:
        with ControlClient(path) as subject, pytest.raises(CellError) as caught:
            subject.call("start", job="cone-capture")
        return caught.value

    raised = serving(path, engine, use)
    assert type(raised) is type(engine.refuse)
    assert (raised.code, str(raised), raised.hint) == (6001, str(engine.refuse), engine.refuse.hint)


def test_every_write_leaves_an_audit_line_with_its_peer_and_reading_leaves_none(
    engine: RecordingEngine, path: Path
) -> None:
    lines: list[tuple[str, str, bool, str]] = []
    writes: dict[str, dict[str, Any]] = {
        "start": {"job": "cone-capture", "dry_run": False},
        "confirm": {"prompt_id": 3},
        "finish": {}, "abort": {}, "halt": {}, "pause": {}, "resume": {}, "reset": {},
        "accept": {"result_id": 4},
        "reject": {"result_id": 5, "why": "loose"},
        "rollback": {"name": "T_flange_camera"},
    }  # fmt: skip

    def use() -> None:
        with ControlClient(path) as subject:
            subject.call("status")
            for method, params in writes.items():
                subject.call(method, **params)

    serving(path, engine, use, lambda *line: lines.append(line))
    assert [what.split()[0] for _, what, _, _ in lines] == list(writes)
    assert all(accepted and f"(uid {os.getuid()})" in who for who, _, accepted, _ in lines)
    assert lines[0][1] == 'start {"job": "cone-capture", "dry_run": false}'
    assert lines[2][1] == "finish"


def test_refused_writes_leave_audit_lines_with_the_reason_and_a_bounded_length(
    engine: RecordingEngine, path: Path
) -> None:
    lines: list[tuple[str, str, bool, str]] = []

    def use() -> None:
        with ControlClient(path) as subject:
            engine.refuse = error("BUSY", "cone-capture, run 6")
            for method, params in (
                ("start", {"job": "x" * 5000}),
                ("confirm", {"prompt_id": "seven"}),
            ):
                with pytest.raises(CellError):
                    subject.call(method, **params)
            engine.refuse = ZeroDivisionError("division by zero")
            with pytest.raises(CellError):
                subject.call("halt")

    serving(path, engine, use, lambda *line: lines.append(line))
    assert [accepted for _, _, accepted, _ in lines] == [False, False, False]
    assert "run 6" in lines[0][3]
    assert "not of type int" in lines[1][3]
    assert "division by zero" in lines[2][3]
    assert len(lines[0][1]) < 600


def test_a_write_that_the_end_of_the_server_cuts_short_is_in_the_audit(path: Path) -> None:
    lines: list[tuple[str, str, bool, str]] = []
    begun = asyncio.Event()

    class SlowEngine(RecordingEngine):
        async def pause(self, who: str) -> None:
            begun.set()
            await asyncio.sleep(60.0)

    async def scenario() -> None:
        subject = ControlServer(path, SlowEngine(), lambda *line: lines.append(line))
        await subject.start()
        _, writer = await asyncio.open_unix_connection(path)
        writer.write(b'{"id": 1, "method": "pause"}\n')
        await asyncio.wait_for(begun.wait(), 5.0)
        await subject.stop()
        writer.close()

    asyncio.run(scenario())
    assert [(what, accepted, detail) for _, what, accepted, detail in lines] == [
        ("pause", False, "CancelledError")
    ]


def test_an_unforeseen_failure_is_an_internal_error_and_the_server_goes_on(
    engine: RecordingEngine, path: Path
) -> None:
    engine.refuse = ZeroDivisionError("division by zero")

    def use() -> tuple[str, Any]:
        with ControlClient(path) as subject:
            with pytest.raises(CellError) as caught:
                subject.call("halt")
            return caught.value.name, subject.call("status")

    assert serving(path, engine, use) == ("INTERNAL", {"packml": "IDLE"})


def test_the_socket_is_for_its_owner_and_group_only_and_gone_after_the_stop(
    engine: RecordingEngine, path: Path
) -> None:
    mode = serving(path, engine, lambda: stat.S_IMODE(path.stat().st_mode))
    assert mode == 0o660
    assert list(path.parent.iterdir()) == []


def test_the_socket_file_of_a_killed_daemon_is_replaced(engine: RecordingEngine, path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))

    def use() -> Any:
        with ControlClient(path) as subject:
            return subject.call("status")

    assert serving(path, engine, use) == {"packml": "IDLE"}


def test_a_second_daemon_is_refused_and_the_first_one_keeps_its_socket(
    engine: RecordingEngine, path: Path
) -> None:
    async def scenario() -> Any:
        first, second = ControlServer(path, engine), ControlServer(path, engine)
        await first.start()
        try:
            with pytest.raises(CellError, match="Another daemon") as caught:
                await second.start()
            await second.stop()
            with await asyncio.to_thread(ControlClient, path) as client:
                answer = await asyncio.to_thread(client.call, "status")
            return caught.value.name, answer
        finally:
            await first.stop()

    assert asyncio.run(scenario()) == ("DAEMON_RUNNING", {"packml": "IDLE"})


@pytest.mark.parametrize("make", [Path.touch, lambda p: p.mkdir()])
def test_an_ordinary_file_in_the_place_of_the_socket_is_never_removed(
    engine: RecordingEngine, path: Path, make: Callable[[Path], Any]
) -> None:
    make(path)
    with pytest.raises(CellError, match="not a socket"):
        serving(path, engine, lambda: None)
    assert path.exists()


def test_a_path_too_long_for_a_unix_socket_is_said(engine: RecordingEngine, tmp_path: Path) -> None:
    path = tmp_path / ("x" * 120)
    with pytest.raises(CellError, match="107 bytes"):
        serving(path, engine, lambda: None)


def test_watch_sends_the_status_now_and_after_a_change(engine: RecordingEngine, path: Path) -> None:
    async def scenario() -> list[Any]:
        server = ControlServer(path, engine)
        await server.start()
        loop = asyncio.get_running_loop()

        def use() -> list[Any]:
            seen = []
            with ControlClient(path) as subject:
                for status in subject.watch():
                    seen.append(status["packml"])
                    if len(seen) == 1:
                        loop.call_soon_threadsafe(engine.change, "EXECUTE")
                    if "EXECUTE" in seen:
                        return seen
            return seen

        try:
            return await asyncio.wait_for(asyncio.to_thread(use), 20)
        finally:
            await server.stop()

    assert asyncio.run(scenario()) == ["IDLE", "EXECUTE"]


def test_a_storm_of_changes_reaches_a_watcher_at_a_limited_rate(engine: RecordingEngine, path: Path) -> None:
    async def scenario() -> tuple[int, float]:
        server = ControlServer(path, engine)
        await server.start()
        reader, writer = await asyncio.open_unix_connection(path)
        began = time.monotonic()
        try:
            writer.write(b'{"id": 1, "method": "watch"}\n')
            for i in range(300):
                engine.change(str(i))
                await asyncio.sleep(0.002)
            await asyncio.sleep(0.3)
            told = len((await reader.read(1 << 20)).splitlines())
            return told, time.monotonic() - began
        finally:
            writer.close()
            await server.stop()

    told, took_s = asyncio.run(scenario())
    # The answer and the first state, then one state a period, however long the storm took.
    assert 2 <= told <= 2 + took_s / WATCH_PERIOD_S


def test_a_watcher_that_goes_away_is_unsubscribed(engine: RecordingEngine, path: Path) -> None:
    async def scenario() -> list[Any]:
        server = ControlServer(path, engine)
        await server.start()
        try:
            _, writer = await asyncio.open_unix_connection(path)
            writer.write(b'{"id": 1, "method": "watch"}\n')
            await until(lambda: bool(engine.listeners))
            writer.close()
            await until(lambda: not engine.listeners)
            return engine.listeners
        finally:
            await server.stop()

    assert asyncio.run(scenario()) == []


def test_stop_ends_a_connection_that_still_waits(engine: RecordingEngine, path: Path) -> None:
    async def scenario() -> bytes:
        server = ControlServer(path, engine)
        await server.start()
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(b'{"id": 1, "method": "watch"}\n')
        await reader.readline()
        await server.stop()
        rest = await asyncio.wait_for(reader.read(), 5)
        writer.close()
        return rest

    assert b"error" not in asyncio.run(scenario())


def test_a_client_without_a_daemon_says_where_it_looked(path: Path) -> None:
    with pytest.raises(CellError, match=str(path)) as caught:
        ControlClient(path)
    assert caught.value.name == "DAEMON_UNREACHABLE"


def test_the_detail_of_an_audit_line_is_bounded_as_well(engine: RecordingEngine, path: Path) -> None:
    lines: list[tuple[str, str, bool, str]] = []
    engine.refuse = error("UNKNOWN_JOB", "x" * 900_000)

    def use() -> None:
        with ControlClient(path) as subject, pytest.raises(CellError):
            subject.call("halt")

    serving(path, engine, use, lambda *line: lines.append(line))
    assert len(lines[0][3]) < 600
