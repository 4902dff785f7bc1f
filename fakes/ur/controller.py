"""A whole UR controller on one loopback address: four servers around one robot, driven by one ticker."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from fakes.faults.vocabulary import Link
from fakes.ur import dashboard, primary, rtde
from fakes.ur.dashboard import Dashboard, DashboardConnection
from fakes.ur.faults import StreamFaults
from fakes.ur.primary import PrimaryServer, TextConnection
from fakes.ur.robot import ContactForce, DigitalIn, Identity, Robot, no_contact, nothing_wired
from fakes.ur.rtde import RtdeConnection, RtdeServer
from fakes.ur.scripting import ScriptPort
from fakes.wire.ticker import Ticker
from fakes.world.arm.kinematics import Chain, chain
from fakes.world.arm.reported import Reported
from fakes.world.arm.servo import Servo
from fakes.world.arm.track import Track

SCRIPT_PORT = 30003
HOME = (0.0, -1.8, 1.8, -1.57, -1.57, 0.0)


def default_track() -> Track:
    """An arm at rest in a common working pose."""
    return Track(time.monotonic(), np.array(HOME))


@dataclass
class Controller:
    """Ports 29999, 30001, 30003 and 30004 on ``bind``; the ports are fixed, addresses tell robots apart."""

    bind: str
    identity: Identity = field(default_factory=Identity)
    track: Track = field(default_factory=default_track)
    believed: Chain | None = None
    contact: ContactForce = no_contact
    now: Callable[[], float] = time.monotonic
    digital_in: DigitalIn = nothing_wired
    servo: Servo | None = None
    reported: Reported | None = None

    def __post_init__(self) -> None:
        believed = self.believed or chain(self.identity.model, self.identity.deltas)
        self.faults = StreamFaults()
        self.robot = Robot(
            self.identity,
            self.track,
            believed,
            self.now,
            self.contact,
            self.digital_in,
            self.servo,
            self.reported,
        )
        self.rtde = RtdeServer(self.robot, self.faults)
        self.dashboard = Dashboard(self.robot)
        self.scripts = ScriptPort(self.robot)
        self.primary = PrimaryServer(self.robot, self.scripts, self.faults)
        self.ticker = Ticker(self.robot.rate, self._cycle, self.now, self.robot.stood_still)
        self._text_links: set[Link] = set()
        self._servers: list[asyncio.Server] = []
        self._listening = asyncio.Lock()
        self._off = False

    async def start(self) -> None:
        """Listen and run; ``OSError`` when a port is taken."""
        try:
            await self.listen()
        except OSError:
            await self.refuse()
            raise
        self.ticker.start()

    async def stop(self) -> None:
        """Close everything."""
        self.ticker.stop()
        await self.refuse()
        self.cut()

    async def listen(self) -> None:
        """Accept connections; not while the controller is off."""
        async with self._listening:
            if not self._servers and not self._off:
                await self._open_ports()

    async def _open_ports(self) -> None:
        loop = asyncio.get_running_loop()
        factories: dict[int, Callable[[], asyncio.Protocol]] = {
            rtde.PORT: lambda: RtdeConnection(self.rtde),
            dashboard.PORT: lambda: DashboardConnection(self.dashboard, self.faults, self._text_links),
            primary.PORT: lambda: TextConnection(self.primary, self.primary.links, greeting=True),
            SCRIPT_PORT: lambda: TextConnection(self.primary, self._text_links, greeting=False),
        }
        for port, factory in factories.items():
            self._servers.append(await loop.create_server(factory, self.bind, port))

    async def refuse(self) -> None:
        """Stop accepting connections; open ones stay."""
        servers, self._servers = self._servers, []
        for server in servers:
            server.close()

    def cut(self, reset: bool = False, rtde_only: bool = False) -> None:
        """End open connections, with FIN or with RST."""
        self.rtde.drop_all(reset)
        if not rtde_only:
            for link in (*self._text_links, *self.primary.links):
                link.close(reset)

    async def reboot(self, off_s: float, serial: str | None = None) -> None:
        """Restart the controller: connections go, ports are closed for ``off_s``, the stamp begins anew."""
        self._off = True
        await self.refuse()
        self.ticker.stop()
        self.cut(reset=True)
        serial = serial or self.robot.identity.serial
        self.robot.reboot(replace(self.robot.identity, serial=serial))
        await asyncio.sleep(off_s)
        self._off = False
        self.robot.boot_time = self.now()
        await self.listen()
        self.ticker.start()

    def _cycle(self, t: float) -> None:
        now = self.robot.step(t)
        self.rtde.publish(now)
        self.primary.publish(now)
