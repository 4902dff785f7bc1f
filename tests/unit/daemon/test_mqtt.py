"""The plant's broker, a real Mosquitto: what it is told, and that nothing is lost while it is away."""

import asyncio
import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import closing, suppress
from functools import wraps
from pathlib import Path
from typing import Any, Self

import aiomqtt
import pytest
from pydantic import ValidationError

from bench.plant import PlayedEngine
from cell.clock import MonotonicClock
from cell.store.runs import RunFolder, load_run
from daemon.config.mqtt_section import MqttSection
from daemon.mqtt.messages import run_message, state_message
from daemon.mqtt.outbox import FILE, Outbox
from daemon.mqtt.publisher import Publisher

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
wire = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


def in_loop(scene: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """A test that is a coroutine."""

    @wraps(scene)
    def test(*args: Any, **kwargs: Any) -> None:
        asyncio.run(scene(*args, **kwargs))

    return test


class Engine:
    """What the publisher reads of the engine, set by hand."""

    def __init__(self) -> None:
        self.active = False
        self.error: dict[str, Any] | None = None
        self.listeners: list[Callable[[], None]] = []

    def status(self) -> dict[str, Any]:
        return {
            "cell": "bay 3", "twin": True, "packml": "IDLE", "job": None, "tool": None, "run_id": None,
            "state": None, "step": 0, "steps": 0, "latched": False, "prompt": None,
            "error": self.error, "waiting": [],
            "devices": {"arm": {"state": "READY"}},
        }  # fmt: skip

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        self.listeners.append(listener)
        return lambda: self.listeners.remove(listener)

    def changed(self, error: dict[str, Any] | None) -> None:
        self.error = error
        for listener in self.listeners:
            listener()


class Broker:
    """Mosquitto on a loopback port of its own, with nothing kept over a restart."""

    def __init__(self, folder: Path) -> None:
        with closing(socket.create_server(("127.0.0.1", 0))) as free:
            self.port = free.getsockname()[1]
        self._file = folder / "mosquitto.conf"
        self._file.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        assert MOSQUITTO is not None
        self._process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self._file)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for _ in range(200):
            with suppress(OSError), closing(socket.create_connection(("127.0.0.1", self.port), 1.0)):
                return
            time.sleep(0.05)
        raise AssertionError("mosquitto does not listen")

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    made = Broker(tmp_path)
    made.start()
    yield made
    made.kill()


def add_run(state: Path, run_id: int, ended: bool = True) -> RunFolder:
    run = RunFolder.create(state / "runs", "laser-check", run_id, {}, MonotonicClock())
    if ended:
        run.finish({"outcome": "complete", "packml": "COMPLETE", "verdict": "pass", "error": None})
    else:
        run.close()
    return run


Messages = list[dict[str, Any]]


async def listening(port: int, topic: str, enough: Callable[[Messages], bool]) -> "asyncio.Task[Messages]":
    """From now on the messages of a topic, until they are enough; what is retained comes at once."""
    subscribed = asyncio.Event()
    task = asyncio.create_task(_heard(port, topic, enough, subscribed))
    async with asyncio.timeout(60.0):
        await subscribed.wait()
    return task


async def _heard(
    port: int, topic: str, enough: Callable[[Messages], bool], subscribed: asyncio.Event
) -> Messages:
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.subscribe(topic, qos=1)
        subscribed.set()
        found: Messages = []
        async with asyncio.timeout(60.0):
            async for message in client.messages:
                payload = message.payload
                assert isinstance(payload, bytes)
                found.append({"topic": message.topic.value, "body": json.loads(payload)})
                if enough(found):
                    break
        return found


def runs_of(found: Messages) -> list[int]:
    return [m["body"]["run_id"] for m in found]


def section(port: int) -> MqttSection:
    return MqttSection(enabled=True, port=port, topic="plant/hall-2", state_every_s=0.2)


@pytest.mark.wire
@wire
@in_loop
async def test_state_alarms_and_runs_reach_the_broker(tmp_path: Path, broker: Broker) -> None:
    engine = Engine()
    await asyncio.to_thread(add_run, tmp_path, 1)
    listener = await listening(broker.port, "plant/hall-2/bay 3/#", lambda found: len(found) == 5)
    subject = asyncio.create_task(Publisher(section(broker.port), engine, "bay 3", tmp_path).run())
    await asyncio.sleep(1.0)
    engine.changed({"code": 3001, "name": "ARM_PROTECTIVE_STOP"})
    found = await listener
    await ended(subject)
    by_topic = {m["topic"].rpartition("/")[2]: m["body"] for m in found}
    assert by_topic["online"] == 1
    assert by_topic["run"]["run_id"] == 1
    assert by_topic["run"]["verdict"] == "pass"
    assert by_topic["state"]["error"]["code"] == 3001
    assert by_topic["alarm"]["error"]["name"] == "ARM_PROTECTIVE_STOP"
    assert by_topic["state"]["devices"] == {"arm": "READY"}


@pytest.mark.wire
@wire
@in_loop
async def test_nothing_is_lost_while_broker_or_daemon_are_away(tmp_path: Path, broker: Broker) -> None:
    engine = Engine()
    topic = "plant/hall-2/bay 3/run"
    await asyncio.to_thread(add_run, tmp_path, 1)
    first = await listening(broker.port, topic, bool)
    subject = asyncio.create_task(Publisher(section(broker.port), engine, "bay 3", tmp_path).run())
    assert runs_of(await first) == [1]
    await asyncio.to_thread(broker.kill)
    for run_id in range(2, 30):
        await asyncio.to_thread(add_run, tmp_path, run_id)
    engine.changed(None)
    await asyncio.sleep(0.5)
    await ended(subject)  # the daemon goes, too
    await asyncio.to_thread(broker.start)
    second = await listening(broker.port, topic, lambda found: runs_of(found)[-1] == 29)
    again = asyncio.create_task(Publisher(section(broker.port), engine, "bay 3", tmp_path).run())
    told = runs_of(await second)
    # A broker that was killed before it confirmed a run is told it again.
    assert told in (list(range(2, 30)), list(range(1, 30)))
    await asyncio.to_thread(add_run, tmp_path, 30)
    third = await listening(broker.port, topic, bool)
    engine.changed(None)
    assert runs_of(await third) == [30], "none comes twice"
    await ended(again)


@pytest.mark.wire
@wire
@in_loop
async def test_what_happens_in_a_run_while_the_broker_is_dead_is_told_once_it_is_back(
    tmp_path: Path, broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.mqtt.publisher._AGAIN_S", (0.2,))
    may_connect, connect = asyncio.Event(), Publisher._client
    may_connect.set()

    async def client(self: Publisher) -> aiomqtt.Client:
        await may_connect.wait()
        return await connect(self)

    monkeypatch.setattr(Publisher, "_client", client)
    engine = Engine()
    engine.active = True  # a job runs: it has the disk, and no run is looked for
    online = await listening(broker.port, "plant/hall-2/bay 3/online", bool)
    subject = asyncio.create_task(Publisher(section(broker.port), engine, "bay 3", tmp_path).run())
    await online
    await asyncio.to_thread(broker.kill)
    for code in (3001, 3015):
        engine.changed({"code": code, "name": str(code)})
        engine.changed(None)
    await asyncio.to_thread(add_run, tmp_path, 1)
    await asyncio.sleep(0.5)
    may_connect.clear()  # the broker keeps no alarm for who listens later: somebody has to before
    await asyncio.sleep(0.5)  # an attempt that was under way has failed
    await asyncio.to_thread(broker.start)
    told = await listening(broker.port, "plant/hall-2/bay 3/+", lambda found: len(kinds(found, "run")) == 1)
    may_connect.set()
    engine.active = False
    engine.changed(None)
    found = await told
    await ended(subject)
    codes = [(m["body"]["error"] or {}).get("code") for m in kinds(found, "alarm")]
    assert [code for code, before in zip(codes, [0, *codes], strict=False) if code != before] == [
        3001, None, 3015, None,
    ]  # fmt: skip
    assert runs_of(kinds(found, "run")) == [1]


def kinds(found: Messages, last: str) -> Messages:
    return [m for m in found if m["topic"].endswith(f"/{last}")]


async def ended(task: "asyncio.Task[None]") -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


class DeafClient:
    """A client that loses a cancellation, once: while it waits for an answer, or as its closing fails."""

    def __init__(self, closing_fails: bool) -> None:
        self.asked = asyncio.Event()
        self._closing_fails = closing_fails
        self._lost = False

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        if self._closing_fails and not self._lost:
            self._lost = True
            raise aiomqtt.MqttError("not connected")

    async def publish(self, *args: Any, **kwargs: Any) -> None:
        self.asked.set()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            if self._closing_fails or self._lost:
                raise
            self._lost = True


@pytest.mark.parametrize("closing_fails", [False, True])
@in_loop
async def test_it_ends_when_it_is_told_to_whatever_the_client_makes_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, closing_fails: bool
) -> None:
    client = DeafClient(closing_fails)
    monkeypatch.setattr("daemon.mqtt.publisher.aiomqtt.Client", lambda *_, **__: client)
    subject = asyncio.create_task(Publisher(section(1), Engine(), "bay 3", tmp_path).run())
    await client.asked.wait()
    subject.cancel()
    done, _ = await asyncio.wait([subject], timeout=10.0)
    assert done == {subject}
    assert subject.cancelled()


CHILD = """
import asyncio, pathlib, sys
from daemon.mqtt.publisher import Publisher
from tests.unit.daemon.test_mqtt import Engine, section
asyncio.run(Publisher(section(int(sys.argv[1])), Engine(), "bay 3", pathlib.Path(sys.argv[2])).run())
"""


@pytest.mark.wire
@wire
@in_loop
async def test_the_broker_says_when_the_daemon_was_killed(tmp_path: Path, broker: Broker) -> None:
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", CHILD, str(broker.port), str(tmp_path)),
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    topic = "plant/hall-2/bay 3/online"
    alive = await (await listening(broker.port, topic, bool))
    assert [m["body"] for m in alive] == [1]
    killed = await listening(broker.port, topic, lambda found: found[-1]["body"] == 0)
    child.kill()
    assert [m["body"] for m in await killed][-1] == 0
    await child.wait()


@in_loop
async def test_a_broker_that_is_not_there_costs_one_line_in_the_log(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.mqtt.publisher._AGAIN_S", (0.01,))
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    engine = Engine()
    subject = asyncio.create_task(Publisher(section(port), engine, "bay 3", tmp_path).run())
    await asyncio.sleep(0.5)
    assert not subject.done()
    await ended(subject)
    assert len([r for r in caplog.records if "not reached" in r.message]) == 1
    assert engine.listeners == []


def test_the_order_is_kept_and_a_run_that_goes_on_holds_the_later_ones(tmp_path: Path) -> None:
    for run_id in (1, 2, 4):
        add_run(tmp_path, run_id)
    add_run(tmp_path, 3, ended=False)
    subject = Outbox(tmp_path)
    assert [run_id for run_id, _ in subject.waiting()] == [1, 2]
    subject.acknowledge(2)
    assert list(Outbox(tmp_path).waiting()) == []
    for run in [load_run(tmp_path / "runs", 3)]:
        run.mark_interrupted()
    assert [(i, m["outcome"]) for i, m in Outbox(tmp_path).waiting()] == [(3, "interrupted"), (4, "complete")]


def test_a_lost_mark_tells_all_runs_anew(tmp_path: Path) -> None:
    add_run(tmp_path, 1)
    Outbox(tmp_path).acknowledge(1)
    (tmp_path / FILE).write_text("{")
    assert [run_id for run_id, _ in Outbox(tmp_path).waiting()] == [1]


def test_a_broker_without_the_library_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.config.mqtt_section.find_spec", lambda name: None)
    with pytest.raises(ValidationError, match=r"cellward\[mqtt\]"):
        MqttSection(enabled=True)
    assert not MqttSection().enabled


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"user": "a"}, "user and password_file"),
        ({"user": "a", "password_file": "/p", "host": "10.0.0.1"}, "TLS alone"),
        ({"tls_cert": "/c"}, "tls_cert and tls_key"),
        ({"topic": "a/#"}, "pattern"),
        ({"password_file": "p", "user": "a"}, "absolute"),
    ],
)
def test_a_section_that_cannot_be_meant_is_refused(keys: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        MqttSection.model_validate(keys)


def test_a_run_tells_the_recipe_and_the_tool_that_it_worked_with(tmp_path: Path) -> None:
    info = {"recipe": "left-bay", "values": {"tool": {"name": "needle"}}}
    run = RunFolder.create(tmp_path, "laser-check", 4, info, MonotonicClock())
    run.close()
    told = run_message(run, {"outcome": "stopped"})
    assert (told["job"], told["recipe"], told["tool"]) == ("laser-check", "left-bay", "needle")


def test_the_bench_of_a_plant_plays_all_that_a_cell_tells() -> None:
    assert state_message(PlayedEngine("bay-1").status())["job"] == "cone-capture"
