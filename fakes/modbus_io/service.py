"""From requests to replies: the module's pace, and the faults that every wire shares."""

import asyncio
import logging
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from fakes.faults.vocabulary import Link, LinkFaults
from fakes.modbus_io.module import UnitTables
from fakes.modbus_io.pdu import DEVICE_FAILURE, exception, respond

log = logging.getLogger("cellward.twin.io")


@dataclass
class Pace:
    """How long the module looks at a request before it acts: uniform in ``delay_s .. delay_s + jitter_s``."""

    delay_s: float = 0.001
    jitter_s: float = 0.001
    generator: random.Random = field(default_factory=lambda: random.Random(1))

    def draw(self) -> float:
        return self.delay_s + self.jitter_s * self.generator.random()


@dataclass
class ServiceFaults:
    """How replies misbehave on every wire of one module."""

    link: LinkFaults = field(default_factory=LinkFaults)
    silent: bool = False
    duplicate: bool = False


class Service:
    """Answers for one module: a request waits its delay, is processed at one instant and answered at once."""

    def __init__(self, module: UnitTables, pace: Pace) -> None:
        self.module, self.pace = module, pace
        self.faults = ServiceFaults()

    def later(self, act: Callable[[], None]) -> asyncio.TimerHandle:
        """Call ``act`` when the module gets to the request; never before other connections had a turn."""
        return asyncio.get_running_loop().call_later(self.pace.draw(), act)

    def reply(self, request: bytes) -> bytes:
        """The reply; a defect of the twin is exception 4 and a traceback on stderr, not a dead connection."""
        try:
            return respond(self.module, request)
        except Exception:
            log.exception("the twin's Modbus device could not answer %s", request.hex())
            return exception(request[0], DEVICE_FAILURE)

    def send(self, link: Link, frame: bytes) -> None:
        """Put a reply on the wire as the faults in force have it."""
        if not self.faults.silent:
            link.send(frame * 2 if self.faults.duplicate else frame)
