"""The demo's PLC on the encoder's CAN bus: it starts a job there, as the manual of the CAN trigger tells."""

import asyncio
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import can

from cell.clock import MonotonicClock
from cell.errors import error
from daemon.can.frames import ACKNOWLEDGE, COMMAND
from daemon.config.faces import CanSection
from daemon.demo.plc import POLL_S, REFUSED, START, Plc, refusal_of
from drivers.can_bus.link import CanLink

GATEWAY_PORT = 29536  # of a twin's CAN bus
OPEN_S, ANSWER_S, AGAIN_S = 5.0, 20.0, 1.0


class PlcOnCan(Plc):
    """A PLC that is a node on the twin's CAN bus, too, with a sequence of its own there."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self._bus = f"socketcand:{host}:{GATEWAY_PORT}/can0"
        self._sequence = 0

    def start_over_can(self, job: int) -> None:
        """Start a job, and keep beating over Modbus; a refusal is raised as the error it names."""
        self._sequence += 1
        with ThreadPoolExecutor(1) as thread:
            answer = thread.submit(lambda: asyncio.run(self._ask(job)))
            while not answer.done():
                self.poll()
                time.sleep(POLL_S)
        if (code := answer.result()) >= REFUSED:
            raise refusal_of(START, code - REFUSED, "CAN")

    async def _ask(self, job: int) -> int:
        """Send the command until it is answered; the result code of the answer that has its sequence."""
        keys, told = CanSection(), asyncio.get_running_loop().create_future()

        def take(messages: Sequence[can.Message], looked: float, now: float) -> None:
            for message in messages:
                if message.arbitration_id == keys.acknowledge_id and len(message.data) == 8:
                    sequence, result, *_ = ACKNOWLEDGE.unpack(bytes(message.data))
                    if sequence == self._sequence and not told.done():
                        told.set_result(result)

        def lost(failure: Exception) -> None:
            if not told.done():
                told.set_exception(failure)

        link = CanLink("the PLC", self._bus, [(keys.acknowledge_id, False)], take, lost, MonotonicClock())
        await link.open(OPEN_S)
        try:
            async with asyncio.timeout(ANSWER_S):
                while not told.done():
                    await link.send(keys.command_id, COMMAND.pack(START, job, self._sequence, 0))
                    await asyncio.wait([told], timeout=AGAIN_S)
                return int(told.result())
        except TimeoutError as exc:
            raise error("CALL_TIMEOUT", f"a start over CAN was not acknowledged in {ANSWER_S:g} s") from exc
        finally:
            await link.close()


def share_encoders_bus(config: Path, bus: str) -> None:
    """Into the twin's own ``cell.toml``, which is the demo's to change: commands come from ``bus``, too."""
    with config.open("a", encoding="utf-8") as file:
        file.write(f'\n[can]\nenabled = true\nbus = "{bus}"\n')
