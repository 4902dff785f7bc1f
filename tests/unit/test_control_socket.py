"""The control socket and its client, on a real unix socket with a stand-in engine."""

import asyncio
import json
import os
import random
import re
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from control_harness import RecordingEngine

from bench._mutate import NUMBERS, OTHERS
from cell.errors import CellError, error
from daemon.control import MAX_CONNECTIONS, ControlServer
from daemon.control_client import ControlClient


@pytest.fixture
def engine() -> RecordingEngine:
    return RecordingEngine()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "control.sock"


def serving(
    path: Path, engine: RecordingEngine, use: Callable[[], Any], audit: Callable[..., None] | None = None
) -> Any:
    """Run the blocking ``use`` in a thread beside a server; its value."""

    async def scenario() -> Any:
        server = ControlServer(path, engine, audit)
        await server.start()
        try:
            return await asyncio.wait_for(asyncio.to_thread(use), 20)
        finally:
            await server.stop()

    return asyncio.run(scenario())


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
    assert engine.asked[0][:5] == ("start", "cone-capture", {"settle_s": "0.5"}, False, 3)
    assert engine.asked[0][6] == "control"
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


@pytest.mark.parametrize(
    ("request_line", "told"),
    [
        (b"{]\n", "not JSON"),
        (b"[1]\n", "not an object"),
        (b'{"id": 1, "method": "explode"}\n', "no method 'explode'"),
        (b'{"id": 1, "method": "confirm"}\n', "needs 'prompt_id'"),
        (b'{"id": 1, "method": "confirm", "params": {"prompt_id": "7"}}\n', "'prompt_id' is not of type int"),
        (b'{"id": 1, "method": "confirm", "params": {"prompt_id": true}}\n', "is not of type int"),
        (b'{"id": 1, "method": "start", "params": [1]}\n', "not an object"),
        (b"x" * (1 << 20) + b"xxx\n", "longer than"),
    ],
)
def test_a_malformed_request_is_refused_in_a_sentence(
    engine: RecordingEngine, path: Path, request_line: bytes, told: str
) -> None:
    def use() -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX) as raw:
            raw.settimeout(5)
            raw.connect(str(path))
            raw.sendall(request_line)
            with raw.makefile("rb") as lines:
                return json.loads(lines.readline())

    reply = serving(path, engine, use)
    assert reply["error"]["name"] == "ARGUMENT_INVALID"
    assert told in reply["error"]["text"]


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
    async def scenario() -> int:
        server = ControlServer(path, engine)
        await server.start()
        reader, writer = await asyncio.open_unix_connection(path)
        try:
            writer.write(b'{"id": 1, "method": "watch"}\n')
            for i in range(300):
                engine.change(str(i))
                await asyncio.sleep(0.002)
            await asyncio.sleep(0.3)
            return len((await reader.read(1 << 20)).splitlines())
        finally:
            writer.close()
            await server.stop()

    assert 2 <= asyncio.run(scenario()) <= 8


def test_a_watcher_that_goes_away_is_unsubscribed(engine: RecordingEngine, path: Path) -> None:
    async def scenario() -> list[Any]:
        server = ControlServer(path, engine)
        await server.start()
        try:
            _, writer = await asyncio.open_unix_connection(path)
            writer.write(b'{"id": 1, "method": "watch"}\n')
            await _until(lambda: bool(engine.listeners))
            writer.close()
            await _until(lambda: not engine.listeners)
            return engine.listeners
        finally:
            await server.stop()

    assert asyncio.run(scenario()) == []


async def _until(condition: Callable[[], bool]) -> None:
    for _ in range(500):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("not within 5 s")


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


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"[" * 100_000 + b"]" * 100_000, "nested deeper"),
        (b'{"method": "accept", "params": {"result_id": 9223372036854775808}}', "beyond 2\\*\\*63"),
        (b'{"method": "accept", "params": {"result_id": 1e999}}', "beyond 2\\*\\*63"),
        (b'{"method": "rollback", "params": {"name": "\\ud800"}}', "not valid Unicode"),
        (b'{"method": "start", "params": ' + b'{"a": ' * 20 + b"1" + b"}" * 20 + b"}", "nested deeper"),
    ],
)
def test_a_request_beyond_the_bounds_is_refused_by_a_sentence(
    engine: RecordingEngine, path: Path, line: bytes, why: str
) -> None:
    def use() -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX) as subject:
            subject.connect(str(path))
            subject.sendall(line + b"\n")
            answer: dict[str, Any] = json.loads(subject.makefile().readline())
            return answer["error"]

    told = serving(path, engine, use)
    assert told["name"] == "ARGUMENT_INVALID"
    assert re.search(why, told["text"])


def _mutated(rng: random.Random) -> bytes:
    """A request with one or more of its parts replaced, lost or doubled, or with its bytes damaged."""
    method, params = rng.choice(
        [
            ("start", {"job": "cone-capture", "params": {"settle_s": "0.5"}, "adopt": 3, "dry_run": True}),
            ("confirm", {"prompt_id": 65537}),
            ("accept", {"result_id": 4, "warned": True}),
            ("reject", {"result_id": 5, "why": "board was loose"}),
            ("rollback", {"name": "T_flange_camera"}),
            ("live", {"since": {"speed": 3}}),
            ("halt", {}),
        ]
    )
    request: dict[str, Any] = {"id": 1, "method": method, "params": params}
    for _ in range(rng.randrange(1, 4)):
        part: Any = rng.choice([request, request.get("params"), request.get("params")])
        if not isinstance(part, dict):
            continue
        key = rng.choice([*part, "unknown"])
        if rng.random() < 0.2:
            part.pop(key, None)
        else:
            part[key] = rng.choice([*NUMBERS, *OTHERS])
    line = json.dumps(request).encode()
    if rng.random() < 0.3:
        at = rng.randrange(len(line))
        line = line[:at] + bytes([rng.randrange(256)]) + line[at + rng.randrange(3) :]
    return line.replace(b"\n", b" ") + b"\n"


@pytest.mark.parametrize("seed", range(4))
def test_mutated_requests_are_each_answered_and_never_by_an_internal_error(
    engine: RecordingEngine, path: Path, seed: int, caplog: pytest.LogCaptureFixture
) -> None:
    lines: list[tuple[str, str, bool, str]] = []

    def use() -> list[tuple[bytes, dict[str, Any]]]:
        rng = random.Random(seed)
        answered = []
        with socket.socket(socket.AF_UNIX) as subject:
            subject.settimeout(5.0)
            subject.connect(str(path))
            answers = subject.makefile()
            for _ in range(500):
                line = _mutated(rng)
                if b'"watch"' in line:
                    continue
                subject.sendall(line)
                answered.append((line, json.loads(answers.readline())))
        return answered

    answered = serving(path, engine, use, lambda *line: lines.append(line))
    assert len(answered) == 500
    for line, answer in answered:
        assert ("result" in answer) != ("error" in answer), line
        assert (answer.get("error") or {}).get("name") != "INTERNAL", (line, answer)
    assert {"result", "error"} <= {key for _, answer in answered for key in answer}
    assert all(len(text) < 600 for line in lines for text in (line[1], line[3]))
    assert not [record for record in caplog.records if record.exc_info]


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
        await _until(lambda: len(waiting) == 2)
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


def test_the_detail_of_an_audit_line_is_bounded_as_well(engine: RecordingEngine, path: Path) -> None:
    lines: list[tuple[str, str, bool, str]] = []
    engine.refuse = error("UNKNOWN_JOB", "x" * 900_000)

    def use() -> None:
        with ControlClient(path) as subject, pytest.raises(CellError):
            subject.call("halt")

    serving(path, engine, use, lambda *line: lines.append(line))
    assert len(lines[0][3]) < 600
