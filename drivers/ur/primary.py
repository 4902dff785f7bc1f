"""The primary port: where the controller tells its active TCP and its factory kinematics.

Packages are ``int32 size`` (itself included), ``uint8 type``, body, big-endian. A robot state (type 16) holds
sub-packages of the same form. Layouts after Universal Robots' client interface description.
"""

import asyncio
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import inf

from cell.answer_time import answer_within
from cell.errors import CellError, error, present
from cell.wire_recording.tap import tap
from drivers.ur.refused import why

PORT = 30001

_ROBOT_STATE = 16
_CARTESIAN_INFO = 4
_KINEMATICS_INFO = 5
_CONFIGURATION_DATA = 6
_HEADER = struct.Struct(">iB")
_MAX_PACKAGE = 1 << 20

Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Kinematics:
    """Denavit-Hartenberg parameters of this very arm, rad and m, and the check sums of its joints."""

    checksum: tuple[int, ...]
    theta: Six
    a: Six
    d: Six
    alpha: Six
    status: int


class PrimarySplitter:
    """Cuts the primary stream into packages of (type, body)."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """The packages completed by ``data``; ``PROTOCOL_VIOLATION`` for an impossible size."""
        data = self._rest + data
        start = 0
        try:
            while len(data) - start >= _HEADER.size:
                size, kind = _HEADER.unpack_from(data, start)
                if not _HEADER.size <= size <= _MAX_PACKAGE:
                    raise error("PROTOCOL_VIOLATION", f"primary package of {size} bytes")
                if len(data) - start < size:
                    break
                body = data[start + _HEADER.size : start + size]
                start += size
                yield kind, body
        finally:
            self._rest = data[start:]


def sub_packages(body: bytes) -> Iterator[tuple[int, bytes]]:
    """The (type, body) pairs inside a robot state."""
    start = 0
    while len(body) - start >= _HEADER.size:
        size, kind = _HEADER.unpack_from(body, start)
        if not _HEADER.size <= size <= len(body) - start:
            raise error("PROTOCOL_VIOLATION", f"primary sub-package {kind} of {size} bytes")
        yield kind, body[start + _HEADER.size : start + size]
        start += size


def parse_tcp_offset(body: bytes) -> Six:
    """The active TCP in the flange, pose6, from a cartesian info: the pose first, then the offset."""
    if len(body) < 96:
        raise error("PROTOCOL_VIOLATION", f"cartesian info of {len(body)} bytes")
    return struct.unpack_from(">6d", body, 48)


def parse_kinematics(body: bytes) -> Kinematics:
    """Check sums, theta, a, d, alpha of six joints, and the calibration status."""
    if len(body) < 24 + 4 * 48:
        raise error("PROTOCOL_VIOLATION", f"kinematics info of {len(body)} bytes")
    checksum = struct.unpack_from(">6I", body, 0)
    rows = [struct.unpack_from(">6d", body, 24 + 48 * k) for k in range(4)]
    status = struct.unpack_from(">I", body, 216)[0] if len(body) >= 220 else 0
    return Kinematics(checksum, rows[0], rows[1], rows[2], rows[3], status)


@dataclass(frozen=True)
class JointLimits:
    """What this controller allows each joint: lowest and highest angle, rad, and highest speed, rad/s.

    None: what it told cannot be that, as ``doubts`` say.
    """

    ranges: tuple[tuple[float, float], ...] | None
    speeds: Six | None
    doubts: tuple[str, ...] = ()

    def told(self) -> dict[str, list[float] | list[list[float]]]:
        """The limits that are known, as the identity of an arm has them."""
        speeds = {} if self.speeds is None else {"joint_speeds_rad_s": list(self.speeds)}
        ranges = {} if self.ranges is None else {"joint_ranges_rad": [list(ends) for ends in self.ranges]}
        return {**speeds, **ranges}


def parse_joint_limits(body: bytes) -> JointLimits:
    """From configuration data: six pairs of lowest and highest angle come first, then six of speed and
    acceleration. Numbers that cannot be limits are not taken: the arm measures as well without them."""
    if len(body) < 192:
        raise error("PROTOCOL_VIOLATION", f"configuration data of {len(body)} bytes")
    ends, moving = struct.unpack_from(">12d", body, 0), struct.unpack_from(">12d", body, 96)
    s1, s2, s3, s4, s5, s6 = moving[::2]
    ranges, speeds = tuple(zip(ends[::2], ends[1::2], strict=True)), (s1, s2, s3, s4, s5, s6)
    doubts: list[str] = []
    if not (rising := all(-inf < low < high < inf for low, high in ranges)):
        doubts.append(_impossible("ranges", ends, "rad"))
    if not (turning := all(0.0 < speed < inf for speed in speeds)):
        doubts.append(_impossible("speeds", speeds, "rad/s"))
    return JointLimits(ranges if rising else None, speeds if turning else None, tuple(doubts))


def _impossible(what: str, values: Iterable[float], unit: str) -> str:
    told = ", ".join(f"{value:g}" for value in values)
    return (
        f"the controller tells joint {what} of {told} {unit}, which cannot be limits: they are not used, and "
        "[limits] is not held against them; see the robot's own safety configuration"
    )


class PrimaryLink:
    """Listens on the primary port: ``on_tcp(offset6)`` at every report, kinematics kept."""

    def __init__(
        self,
        host: str,
        writer: asyncio.StreamWriter,
        on_tcp: Callable[[Six], None],
        on_lost: Callable[[CellError], None],
    ) -> None:
        self.kinematics: Kinematics | None = None
        self.joint_limits: JointLimits | None = None  # None: not told
        self._host, self._writer, self._on_tcp, self._on_lost = host, writer, on_tcp, on_lost
        self._tcp_seen = asyncio.Event()
        self._kinematics_seen = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._tap = tap("primary", f"{host}:{PORT}")

    @classmethod
    async def connect(
        cls,
        host: str,
        on_tcp: Callable[[Six], None],
        on_lost: Callable[[CellError], None],
        timeout: float,
    ) -> "PrimaryLink":
        """Connect and wait for the first report of the TCP; ``DEVICE_UNREACHABLE`` when either fails."""
        try:
            async with asyncio.timeout(timeout):
                reader, writer = await asyncio.open_connection(host, PORT)
        except (OSError, TimeoutError) as exc:
            raise error("DEVICE_UNREACHABLE", f"primary port {host}:{PORT}: {why(exc, PORT)}") from exc
        link = cls(host, writer, on_tcp, on_lost)
        link._task = asyncio.create_task(link._listen(reader), name=f"primary port of {host}")
        try:
            await link._first(link._tcp_seen, "the active TCP", timeout)
        except BaseException:
            await link.close()
            raise
        return link

    async def wait_kinematics(self, timeout: float) -> Kinematics:
        """The factory kinematics, which come with the first report after connecting."""
        await self._first(self._kinematics_seen, "its kinematics", timeout)
        return present(self.kinematics, "kinematics in the report")

    async def close(self) -> None:
        """End the connection and the listener."""
        self._writer.transport.abort()
        self._tap.closed()
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task], timeout=1.0)

    async def _first(self, seen: asyncio.Event, what: str, timeout: float) -> None:
        try:
            async with answer_within(timeout):
                await seen.wait()
        except TimeoutError:
            raise error(
                "DEVICE_UNREACHABLE", f"{self._host}:{PORT} did not report {what} in {timeout:g} s"
            ) from None

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        splitter = PrimarySplitter()
        try:
            while data := await reader.read(65536):
                self._tap.received(data)
                for kind, body in splitter.feed(data):
                    if kind == _ROBOT_STATE:
                        self._take_state(body)
        except CellError as exc:
            self._on_lost(exc)
        except OSError as exc:
            self._on_lost(error("DEVICE_LOST", f"primary port of {self._host}: {exc}"))
        else:
            self._on_lost(error("DEVICE_LOST", f"{self._host} closed the primary port"))

    def _take_state(self, body: bytes) -> None:
        for kind, part in sub_packages(body):
            if kind == _CARTESIAN_INFO:
                self._on_tcp(parse_tcp_offset(part))
                self._tcp_seen.set()
            elif kind == _KINEMATICS_INFO:
                self.kinematics = parse_kinematics(part)
                self._kinematics_seen.set()
            elif kind == _CONFIGURATION_DATA:
                self.joint_limits = parse_joint_limits(part)
