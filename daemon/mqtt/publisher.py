"""The connection to the broker: it comes and goes, and a running job notices neither."""

import asyncio
import logging
import ssl
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import aiomqtt

from cell.store.files import to_json
from daemon.config.mqtt_section import MqttSection
from daemon.mqtt.messages import alarm_message, state_message
from daemon.mqtt.outbox import Outbox

log = logging.getLogger("cellward.mqtt")
_AGAIN_S = (1.0, 2.0, 5.0, 10.0, 30.0)
_ALIVE_S = 15.0
_ALARMS = 1000  # kept while the broker is away; older ones are in the runs that they ended


class Told(Protocol):
    """What the publisher reads of the engine."""

    @property
    def active(self) -> bool: ...

    def status(self) -> dict[str, Any]: ...
    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]: ...


class Publisher:
    """Topics below ``TOPIC/CELL``: ``online`` and ``state`` (retained), ``alarm``, ``run``, with QoS 1."""

    def __init__(
        self,
        section: MqttSection,
        engine: Told,
        cell: str,
        state: Path,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._section, self._engine, self._wall = section, engine, wall
        self._base = f"{section.topic}/{cell}"
        self._outbox = Outbox(state)
        self._alarms: deque[dict[str, Any]] = deque(maxlen=_ALARMS)
        self._error: dict[str, Any] | None = None
        self._changed = asyncio.Event()

    async def run(self) -> None:
        """Publish until cancelled. Whatever goes wrong here is logged once, and tried again."""
        unsubscribe = self._engine.subscribe(self._note)
        failures = 0
        try:
            while True:
                try:
                    async with await self._client() as client:
                        log.info("the broker %s:%d is told", self._section.host, self._section.port)
                        failures = 0
                        await self._tell(client)
                except (aiomqtt.MqttError, OSError, ValueError) as exc:
                    if failures == 0:
                        log.warning("the broker is not reached (%s); runs wait for it", exc)
                except Exception:
                    log.exception("telling the broker")
                _end_if_cancelled()
                await asyncio.sleep(_AGAIN_S[min(failures, len(_AGAIN_S) - 1)])
                failures += 1
        finally:
            unsubscribe()

    def _note(self) -> None:
        """After each change: an error that came or went is kept as an alarm until the broker has it."""
        status = self._engine.status()
        if status["error"] != self._error:
            self._error = status["error"]
            self._alarms.append(alarm_message(self._error, status["run_id"], self._wall()))
        self._changed.set()

    async def _client(self) -> aiomqtt.Client:
        section = self._section
        context = password = None
        if section.tls_ca is not None:
            context = await asyncio.to_thread(_tls, section)
        if section.password_file is not None:
            password = (await asyncio.to_thread(Path(section.password_file).read_text, "utf-8")).strip()
        return aiomqtt.Client(
            section.host,
            section.port,
            username=section.user,
            password=password,
            tls_context=context,
            will=aiomqtt.Will(f"{self._base}/online", b"0", qos=1, retain=True),
            keepalive=int(_ALIVE_S),
        )

    async def _tell(self, client: aiomqtt.Client) -> None:
        await self._publish(client, "online", b"1", retain=True)
        told: dict[str, Any] | None = None
        while True:
            self._changed.clear()
            state = state_message(self._engine.status())
            if state != told:
                await self._publish(client, "state", to_json(state), retain=True)
                told = state
            while self._alarms:
                await self._publish(client, "alarm", to_json(self._alarms[0]))
                self._alarms.popleft()
            if not self._engine.active:  # while a job runs nothing can have ended, and it has the disk
                await self._tell_runs(client)
            await asyncio.sleep(self._section.state_every_s)
            try:
                async with asyncio.timeout(_ALIVE_S):
                    await self._changed.wait()
            except TimeoutError:
                await self._publish(client, "online", b"1", retain=True)  # finds a dead connection

    async def _tell_runs(self, client: aiomqtt.Client) -> None:
        waiting = self._outbox.waiting()
        while (entry := await asyncio.to_thread(next, waiting, None)) is not None:
            run_id, message = entry
            await self._publish(client, "run", to_json(message))
            await asyncio.to_thread(self._outbox.acknowledge, run_id)

    async def _publish(
        self, client: aiomqtt.Client, topic: str, payload: bytes | str, retain: bool = False
    ) -> None:
        await client.publish(f"{self._base}/{topic}", payload, qos=1, retain=retain)
        _end_if_cancelled()


def _end_if_cancelled() -> None:
    """``CancelledError`` again where the client has lost it: ``asyncio.wait_for`` of Python 3.11, by which it
    waits for the broker, drops a cancellation that comes with the answer; its closing may fail, too."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def _tls(section: MqttSection) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=section.tls_ca)
    if section.tls_cert is not None:
        context.load_cert_chain(section.tls_cert, section.tls_key)
    return context
