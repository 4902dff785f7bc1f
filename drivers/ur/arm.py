"""A Universal Robots arm as ``cell.devices.Arm``: state always, motion only while a lease holds a port."""

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from cell.clock import Clock
from cell.devices import Arm, ArmState, Identity, SafetyMode, StartsPrograms, ToolSettings
from cell.errors import CellError, error
from cell.following import FULL_SPEED
from cell.own_delay import busy_words
from cell.poses import Array
from cell.samples import Sample, Stream
from cell.to_its_end import run_to_its_end
from cell.wire_recording.tap import tap
from drivers.life import SampledDevice
from drivers.ur.config import UrConfig
from drivers.ur.dashboard import Dashboard, dashboard
from drivers.ur.feed import NAMES, STOPPED, StateFeed, available
from drivers.ur.kinematics import describe
from drivers.ur.motion import UrMotion
from drivers.ur.motion_client import MotionClient
from drivers.ur.primary import PrimaryLink, Six
from drivers.ur.registers import registers_in_use, registers_warning
from drivers.ur.rtde_link import RtdeLink, open_socket

SCRIPT_PORT = 30003
STOP_SCRIPT = b"def cellward_stop():\n  stopj(4.0)\nend\n"
CB3_HZ, E_SERIES_HZ = 125.0, 500.0
POLYSCOPE_X = 10  # first number of its versions
SILENCE_CHECK_S = 0.01
REMOTE_POLL_S = 0.1
DASHBOARD_DEADLINE_S = 1.0
LOAD_DEADLINE_S = 10.0  # of a program; a large one takes a controller seconds
# After the TCP was set, the primary port may still report the old one from its queue.
TCP_SETTLE_S = 0.5


class UrArm(SampledDevice):
    """One arm. Reconnecting is the supervisor's business: after an error ``close`` and ``open`` again."""

    Config = UrConfig
    PLAYS = (Arm, StartsPrograms)

    def __init__(self, name: str, config: UrConfig, clock: Clock) -> None:
        self.state: Stream[ArmState] = Stream(name, clock)
        super().__init__(name, clock, self.state, config.time_offset_s)
        self.feed = StateFeed(self.state, clock, config.time_offset_s)
        self.lost_at = clock.now()
        self._config = config
        self._link: RtdeLink | None = None
        self._primary: PrimaryLink | None = None
        self._port: UrMotion | None = None
        self.motion_begun = False
        self._remote: bool | None = None
        self._dashboard_error = ""
        self._version = ""
        self.cycle_hz = E_SERIES_HZ  # of the controller: it takes a set-point in each cycle
        self._tcp_set_at = -1e9
        self._tcp_in_packages = False
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def host(self) -> str:
        """The controller's address, for what else speaks with it."""
        return self._config.host

    @property
    def expected_lag_s(self) -> float:
        """The look-ahead time: a stream is late by that and a little more."""
        return self._config.servo_lookahead_s

    async def open(self) -> None:
        """Connect the state stream, the primary port and the dashboard; the robot's program is untouched."""
        await self.close()
        self._life.begin()
        try:
            await self._connect()
        except BaseException:
            await self.close()
            raise
        for work, what in ((self._watch_silence(), "silence"), (self._watch_remote(), "remote control")):
            task = asyncio.create_task(work, name=f"{self.name} {what}")
            task.add_done_callback(self._note_watch_end)
            self._tasks.add(task)

    async def close(self) -> None:
        """End motion and every connection."""
        port, self._port = self._port, None
        if port is not None:
            await run_to_its_end(port.close())
        tasks, self._tasks = self._tasks, set()
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=2.0)
        if self._link is not None:
            self._link.close()
        if self._primary is not None:
            await self._primary.close()
        self._link = self._primary = None
        self._remote = None
        self._lose(error("DEVICE_LOST", f"{self.name} was closed"))

    async def identify(self) -> Identity:
        """Serial, model and PolyScope version; ``DEVICE_IDENTITY`` when the config expects another.

        ``extra["kinematics"]``: the arm's own DH rows, their check sums and, as ``calibration``, the deltas
        to the nominal model. ``extra["joint_speeds_rad_s"]`` (6) and ``extra["joint_ranges_rad"]`` (6, 2):
        what this controller allows each joint; without what cannot be limits.
        """
        self._life.require()
        async with dashboard(self._config.host, self._config.connect_timeout_s) as link:
            facts = await link.facts(DASHBOARD_DEADLINE_S)
        if self._primary is None:
            raise error("DEVICE_LOST", f"{self.name} is still connecting")
        found = await self._primary.wait_kinematics(self._config.connect_timeout_s)
        for what, expected, seen in (
            ("serial", self._config.expect_serial, facts.serial),
            ("model", self._config.model, facts.model),
        ):
            if expected is not None and expected != seen:
                raise error(
                    "DEVICE_IDENTITY",
                    f"{self.name} at {self._config.host} has {what} {seen}, expected {expected}",
                )
        extra: dict[str, Any] = {"kinematics": describe(facts.model, found), "urcontrol": self._version}
        if (limits := self._primary.joint_limits) is not None:
            extra |= limits.told()
        return Identity(facts.model, facts.serial, facts.version, extra)

    def health(self) -> dict[str, Any]:
        """Plain numbers and texts for status pages."""
        fault = self.fault()
        silence = self.feed.silence()
        return {
            "connected": self._life.good,
            "stale": silence > self._config.stale_after_s,
            "age_s": silence if self._life.good else None,
            "packages": self.state.received,
            "gaps": self.state.gaps,
            "repeated": self.feed.repeated,
            "reboots": self.feed.reboots,
            "epoch": self.state.epoch,
            "remote_control": self._remote,
            "dashboard": self._dashboard_error or "ok",
            "messages": self._link.messages if self._link is not None else 0,
            "fault": None if fault is None else str(fault),
            "motion_child": self._port.client.pid if self._port is not None else None,
        }

    def check_movable(self) -> None:
        """Raise the coded error that forbids motion now (stale, safety, local mode, foreign program)."""
        self._life.require()
        if self._link is None:
            raise error("DEVICE_LOST", f"{self.name} is still connecting")
        # What the kernel holds already is not silence, however late the loop comes to it.
        self._link.drain()
        self._life.require()
        if self.feed.silence() > self._config.stale_after_s:
            raise error("STALE_DATA", f"{self.name}: the newest state is {self._age()}")
        fault = self.fault()
        if fault is not None:
            raise fault
        if self._remote is None:
            raise error(
                "ARM_NOT_READY",
                f"the dashboard does not tell whether {self.name} is in remote control"
                f" ({self._dashboard_error or 'not asked yet'})",
            )
        ours = self._port is not None and self._port.owns_program
        if self.feed.runtime_state != STOPPED and not ours:
            raise error("ARM_PROGRAM_RUNNING", f"{self.name} has runtime state {self.feed.runtime_state}")

    @property
    def lost(self) -> CellError | None:
        """What ended the link, or None while it is good; a new error each time, as it may be raised often."""
        return self._life.failure

    def fault(self) -> CellError | None:
        """The coded error that the newest package shows, or None."""
        if not self._life.good:
            return self.lost
        finding = self.feed.finding
        if finding is not None:
            return error(finding.name, f"{self.name}: {finding.detail}")
        if self._remote is False:
            return error("ARM_LOCAL_MODE", f"the dashboard of {self.name} says so")
        return None

    async def open_motion(self, tool: ToolSettings) -> UrMotion:
        """Start the motion child, set and read back TCP and payload. Only a lease calls this.

        Refused with ``ARM_PROGRAM_RUNNING``, ``ARM_LOCAL_MODE``, ``ARM_REGISTER_CONFLICT`` and the errors of
        :meth:`check_movable` before anything of ours runs on the arm.
        """
        if self._port is not None:
            raise error("MOTION_BUSY", f"{self.name} has a motion client already")
        self.motion_begun = False
        self.check_movable()
        await self._ask_permission()
        client = MotionClient.start(self._clock)
        self.motion_begun = True
        self._port = port = UrMotion(self, client, tool, self._config)
        try:
            await port.prepare()
        except BaseException:
            await run_to_its_end(port.close())
            raise
        return port

    async def stop_script(self) -> None:
        """Stop ladder, step two: end the motion child and make the controller run a stop."""
        if self._port is not None:
            self._port.client.kill()
        sock = await open_socket(self._config.host, SCRIPT_PORT, 0.5)
        told = tap("script", f"{self._config.host}:{SCRIPT_PORT}")
        told.sent(STOP_SCRIPT)
        try:
            await asyncio.get_running_loop().sock_sendall(sock, STOP_SCRIPT)
            await _read_for(sock, 0.1)
        finally:
            sock.close()
            told.closed()

    async def doubts(self) -> list[str]:
        """What only a probe looks for: registers that a PLC on the controller's fieldbus holds, joint limits
        that cannot be any, a speed slider below full speed, and reduced mode."""
        config = self._config
        names = await registers_in_use(config.host, self._clock, config.connect_timeout_s)
        limits = None if self._primary is None else self._primary.joint_limits
        return [
            *([registers_warning(self.name, names)] if names else []),
            *(limits.doubts if limits is not None else ()),
            *_slider_doubts(self.name, self.feed.speed_fraction),
            *_mode_doubts(self.name, self.state.last()),
        ]

    async def stop_program(self) -> None:
        """Stop ladder, step three: the dashboard's stop, on a connection of its own."""
        async with dashboard(self._config.host, DASHBOARD_DEADLINE_S) as link:
            await link.stop(DASHBOARD_DEADLINE_S)

    async def load_program(self, program: str) -> None:
        """Load a program of the robot's own, which moves nothing; ``ARM_PROGRAM_NOT_STARTED``."""
        async with dashboard(self._config.host, self._config.connect_timeout_s) as link:
            await link.load(program, LOAD_DEADLINE_S)

    async def play_program(self, program: str, last_look: Callable[[], None]) -> None:
        """Start the loaded program: the arm moves by it. Whether it may is asked anew right before.

        What is loaded is asked, too: another client of the dashboard may have loaded something else.
        """
        if self._port is not None:
            raise error("MOTION_BUSY", f"{self.name} has a motion client")
        async with dashboard(self._config.host, self._config.connect_timeout_s) as link:
            await self._require_free(link)
            await link.require_loaded(program, DASHBOARD_DEADLINE_S)
            self.check_movable()
            last_look()
            await link.play(DASHBOARD_DEADLINE_S)

    async def _connect(self) -> None:
        config, timeout = self._config, self._config.connect_timeout_s
        self._link = await RtdeLink.connect(config.host, self._clock, self._lose, timeout)
        version = await self._link.controller_version(timeout)
        self._version = ".".join(str(n) for n in version)
        if version[0] >= POLYSCOPE_X:
            raise error(
                "ARM_NOT_SUPPORTED",
                f"{self.name} at {config.host} has PolyScope X ({self._version}), and this driver needs the"
                " dashboard server of PolyScope 3 or 5",
            )
        self._primary = await PrimaryLink.connect(config.host, self._take_tcp, self._lose, timeout)
        self.cycle_hz = CB3_HZ if version[0] <= 3 else E_SERIES_HZ
        frequency_hz = min(config.rtde_frequency_hz, self.cycle_hz)
        recipe = await self._link.setup_outputs(NAMES, frequency_hz, timeout)
        if "NOT_FOUND" in recipe.types:
            recipe = await self._link.setup_outputs(available(recipe), frequency_hz, timeout)
        self.feed.begin(recipe, frequency_hz)
        self._tcp_in_packages = "tcp_offset" in recipe.names
        await self._link.start(self.feed.take, timeout)
        await self.wait_fresh(timeout)
        await self._ask_remote()

    def _take_tcp(self, offset6: Six) -> None:
        settling = self._clock.now() - self._tcp_set_at < TCP_SETTLE_S
        if not self._tcp_in_packages and not settling:
            self.feed.set_tcp(offset6)

    def tcp_read_back(self, offset6: Array) -> None:
        """The motion port set the TCP and read it back.

        Where the packages carry the TCP they alone tell it: older ones may still wait to be decoded.
        """
        self._tcp_set_at = self._clock.now()
        if not self._tcp_in_packages:
            self.feed.set_tcp(offset6)

    def motion_closed(self) -> None:
        """The motion port ended, by its lease or by our close."""
        self._port = None

    async def _ask_permission(self) -> None:
        """The two questions that only the dashboard answers, asked right before the script is uploaded."""
        async with dashboard(self._config.host, self._config.connect_timeout_s) as link:
            await self._require_free(link)

    async def _require_free(self, link: Dashboard) -> None:
        if not await link.in_remote_control(DASHBOARD_DEADLINE_S):
            raise error("ARM_LOCAL_MODE", f"the dashboard of {self.name} says so")
        answer = await link.ask("running", DASHBOARD_DEADLINE_S)
        if "true" in answer.lower():
            raise error("ARM_PROGRAM_RUNNING", f"the dashboard of {self.name} says '{answer}'")

    async def _ask_remote(self) -> None:
        async with dashboard(self._config.host, self._config.connect_timeout_s) as link:
            self._remote = await link.in_remote_control(DASHBOARD_DEADLINE_S)

    async def _watch_silence(self) -> None:
        while self._life.good and self._link is not None:
            self._link.drain()
            silence = self.feed.silence()
            if silence > self._config.silent_after_s and self._port is not None:
                self._port.interrupt(error("STALE_DATA", f"{self.name}: the newest state is {self._age()}"))
            if silence > self._config.lost_after_s:
                self._lose(error("DEVICE_LOST", f"{self.name} is silent: the newest state is {self._age()}"))
            await self._clock.sleep(SILENCE_CHECK_S)

    async def _watch_remote(self) -> None:
        """Ask for the mode switch ten times a second; without an answer motion is forbidden."""
        link: Dashboard | None = None
        try:
            while self._life.good:
                try:
                    if link is None:
                        link = await Dashboard.connect(self._config.host, DASHBOARD_DEADLINE_S)
                    self._remote = await link.in_remote_control(DASHBOARD_DEADLINE_S)
                    self._dashboard_error = ""
                except CellError as exc:
                    link, self._remote, self._dashboard_error = None, None, str(exc)
                await self._clock.sleep(REMOTE_POLL_S)
        finally:
            if link is not None:
                link.close()

    def _note_watch_end(self, task: asyncio.Task[None]) -> None:
        """A watch that fails would leave the link unwatched."""
        if not task.cancelled() and (failure := task.exception()) is not None:
            self._lose(error("INTERNAL", f"{task.get_name()}: {failure!r}"))

    def _lose(self, failure: CellError) -> None:
        """The link is gone: say so once, and end motion, which nobody can watch any more."""
        if not self._life.lose(failure):
            return
        self.lost_at = self._clock.now()
        if self._link is not None:
            self._link.close()
        if self._port is not None:
            self._port.client.kill()

    def _age(self) -> str:
        return f"{self.feed.silence():.3f} s old{busy_words(self._clock.now())}"


async def _read_for(sock: socket.socket, seconds: float) -> None:
    """Closing with unread data would reset the connection, and the script could be lost with it."""
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout(seconds):
            while await loop.sock_recv(sock, 65536):
                pass
    except TimeoutError:
        return


def _mode_doubts(arm: str, last: Sample[ArmState] | None) -> list[str]:
    """What refuses every job, though the arm can be moved by hand and from the pendant."""
    if last is None or last.value.safety_mode != SafetyMode.REDUCED:
        return []
    return [
        f"{arm}: the safety configuration has it in reduced mode, and jobs are refused with ARM_NOT_READY."
        " Clear what switches that on: a safety input or a plane of the safety configuration"
    ]


def _slider_doubts(arm: str, fraction: float) -> list[str]:
    """What waits for whoever starts a job below full speed."""
    if fraction >= FULL_SPEED:
        return []
    return [
        f"{arm}: the speed slider stands at {100 * fraction:.0f} %. Jobs that follow a belt end with"
        " ARM_SPEED_SCALED below full speed, and all other moves take longer. Set it to 100 % on the pendant"
    ]
