"""The driver for input modules on a serial line and over TLS, against pymodbus' own servers."""

import asyncio
import importlib.util
import os
import shutil
import ssl
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymodbus.framer import FramerRTU, FramerType
from pymodbus.server import ModbusSerialServer, ModbusTlsServer

from cell.errors import CellError
from cell.testing.taken_again import play
from tests.integration.modbus_inputs_rig import HOST, Board, make, newest, opened, with_identity
from tests.integration.ur_driver_rig import own_pauses, untouched
from tests.kit.certificates import authority, certificate

pytestmark = pytest.mark.wire
needs_pyserial = pytest.mark.skipif(
    importlib.util.find_spec("serial") is None, reason="pyserial is not installed (pip install pyserial)"
)
needs_openssl = pytest.mark.skipif(
    shutil.which("openssl") is None, reason="openssl is not installed (apt-get install openssl)"
)
BAUD = "baudrate=115200&parity=N&stopbits=1"


# -- a serial line


class Cable:
    """Two pseudo-terminals whose far ends are joined; the cable can be cut."""

    def __init__(self) -> None:
        self.ends = [os.openpty(), os.openpty()]
        self.names = [os.ttyname(theirs) for _, theirs in self.ends]
        self.cut = False
        for (ours, theirs), (other, _) in zip(self.ends, reversed(self.ends), strict=True):
            tty.setraw(theirs)
            os.set_blocking(ours, False)
            asyncio.get_running_loop().add_reader(ours, self._pass, ours, other)

    def _pass(self, source: int, target: int) -> None:
        data = os.read(source, 4096)
        if not self.cut:
            os.write(target, data)

    def close(self) -> None:
        ends, self.ends = self.ends, []
        for ours, theirs in ends:
            asyncio.get_running_loop().remove_reader(ours)
            os.close(ours)
            os.close(theirs)


@asynccontextmanager
async def serial_server(board: Board) -> AsyncIterator[tuple[Cable, str]]:
    with_identity({"ProductCode": "DI-RTU"})
    cable = Cable()
    server = ModbusSerialServer(board.device(), port=cable.names[0], baudrate=115200, framer=FramerType.RTU)
    await server.serve_forever(background=True)
    try:
        yield cable, f"rtu://{cable.names[1]}?{BAUD}"
    finally:
        await board.finish()
        await server.shutdown()
        cable.close()


@needs_pyserial
def test_a_module_on_a_serial_line_is_read_and_identified() -> None:
    async def scene() -> None:
        board = Board("ADAM-6050", levels=[True, False], counts=[5, 6])
        async with (
            serial_server(board) as (_, url),
            opened(url, module=board.make, unit=3, poll_period_s=0.02) as subject,
        ):
            assert (await subject.identify()).model == "DI-RTU"
            assert (await newest(subject)).value.levels == (True, False)
            board.levels, board.counts = [True, True], [7, 7]
            seen = (await newest(subject)).value
            assert (seen.levels, seen.changes) == ((True, True), (4, 1))
            assert subject.health()["failures"] == 0

    asyncio.run(scene())


class LateSlave:
    """A coupler by hand. It knows no function 43, shows input 0 on at the fourth look and input 1 at others,
    and tells the fourth 30 ms after the client gave it up. The refusal of function 43 takes ``refuses_s``."""

    def __init__(self, refuses_s: float = 0.0) -> None:
        self.refuses_s = refuses_s
        self.ours, self.theirs = os.openpty()
        tty.setraw(self.theirs)
        self.looks = 0
        self.looked_on = asyncio.Event()  # well after the fourth look
        asyncio.get_running_loop().add_reader(self.ours, self._take)

    def _take(self) -> None:
        request = os.read(self.ours, 256)
        if request[1] == 43:
            self._send(self.refuses_s, bytes([request[0], 0xAB, 1]))
            return
        self.looks += 1
        if self.looks == 7:
            self.looked_on.set()
        late = self.looks == 4
        self._send(0.23 if late else 0.08, bytes([request[0], request[1], 1, 0b01 if late else 0b10]))

    def _send(self, delay_s: float, body: bytes) -> None:
        frame = body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
        asyncio.get_running_loop().call_later(delay_s, os.write, self.ours, frame)

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self.ours)
        os.close(self.ours)
        os.close(self.theirs)


@needs_pyserial
@pytest.mark.parametrize("refuses_s", [0.0, 0.23, 0.44])
def test_a_late_reply_on_a_serial_line_does_not_answer_the_next_request(refuses_s: float) -> None:
    async def scene() -> None:
        slave = LateSlave(refuses_s)
        url = f"rtu://{os.ttyname(slave.theirs)}?{BAUD}"
        async with own_pauses() as pauses:
            async with opened(url, module="WAGO-750", poll_period_s=0.002, timeout_s=0.2) as subject:
                seen: list[tuple[bool, ...]] = []
                subject.inputs.subscribe(lambda poll: seen.append(poll.value.levels))
                async with asyncio.timeout(5.0):
                    await slave.looked_on.wait()
                failures = subject.health()["failures"]
            await asyncio.sleep(0.3)
            slave.close()
        if max(pauses, default=0.0) > 0.1:  # of the slave, too: a reply two timeouts late cannot be told
            untouched(pauses)
        assert failures >= 1, "the late reply; a short pause of this machine may add one"
        assert set(seen) == {(False, True)}, "the fourth look was shown as a later one"

    play(scene)


@needs_pyserial
def test_a_serial_line_that_is_cut_loses_the_device_and_one_that_is_not_there_is_unreachable() -> None:
    async def scene() -> None:
        async with (
            serial_server(Board("WAGO-750")) as (cable, url),
            opened(url, module="WAGO-750", poll_period_s=0.02, timeout_s=0.05) as subject,
        ):
            cable.cut = True
            async with asyncio.timeout(3.0):
                assert "no answer in 0.05 s; last received" in str(await subject.wait_lost())
        with pytest.raises(CellError, match="no-such-line") as caught:
            await make("rtu:///dev/no-such-line").open()
        assert caught.value.name == "DEVICE_UNREACHABLE"

    asyncio.run(scene())


# -- TLS


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority, a certificate for ``module.cell`` and one for a client, and somebody else's authority."""
    folder = tmp_path_factory.mktemp("keys")

    for name in ("ca", "other"):
        authority(folder, name)
    for name in ("module", "client"):
        certificate(folder, name, "ca", "module.cell")
    return folder


@asynccontextmanager
async def tls_server(board: Board, keys: Path) -> AsyncIterator[str]:
    """pymodbus' server, which wants a certificate of its clients."""
    with_identity({})
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(keys / "module.pem", keys / "module.key")
    context.load_verify_locations(keys / "ca.pem")
    context.verify_mode = ssl.CERT_REQUIRED
    server = ModbusTlsServer(board.device(), address=(HOST, 0), sslctx=context)
    await server.serve_forever(background=True)
    try:
        yield "tls://{}:{}".format(*server.transport.sockets[0].getsockname())
    finally:
        await board.finish()
        await server.shutdown()
        await asyncio.sleep(0.05)


def tls_settings(keys: Path, **other: Any) -> dict[str, Any]:
    return {
        "module": "ioLogik-E1210",
        "tls_ca": str(keys / "ca.pem"),
        "tls_certificate": str(keys / "client.pem"),
        "tls_key": str(keys / "client.key"),
        "tls_server_name": "module.cell",
        **other,
    }


@needs_openssl
def test_a_module_behind_tls_is_read(keys: Path) -> None:
    async def scene() -> None:
        board = Board(levels=[False, True], counts=[3, 4])
        async with tls_server(board, keys) as url, opened(url, **tls_settings(keys)) as subject:
            assert (await newest(subject)).value.levels == (False, True)
            board.levels, board.counts = [False, False], [5, 4]
            assert (await newest(subject)).value.changes == (4, 1)
            assert subject.health()["failures"] == 0

    asyncio.run(scene())


@needs_openssl
@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        ({"tls_ca": "other.pem"}, "certificate verify failed"),
        ({"tls_server_name": "impostor.cell"}, "impostor.cell"),
        ({"tls_server_name": None}, f"not valid for '{HOST}'"),
        ({"tls_ca": "absent.pem"}, "the TLS files cannot be used"),
        (
            {"tls_certificate": None, "tls_key": None},
            "the other end closes the connection; it may want a certificate of ours",
        ),
    ],
)
def test_a_module_that_cannot_prove_itself_and_a_client_without_certificate_do_not_connect(
    keys: Path, other: dict[str, Any], sentence: str
) -> None:
    paths = {k: str(keys / v) if v and v.endswith(".pem") else v for k, v in other.items()}

    async def scene() -> None:
        async with tls_server(Board(), keys) as url:
            subject = make(url, **tls_settings(keys, **paths))
            with pytest.raises(CellError) as caught:
                await subject.open()
            assert caught.value.name == "DEVICE_UNREACHABLE"
            assert sentence in str(caught.value)

    asyncio.run(scene())


@needs_openssl
def test_a_reply_in_two_parts_over_tls_is_put_together(keys: Path) -> None:
    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while request := await reader.read(1024):
                refuse = request[7] == 43
                body = bytes([request[6], 0xAB, 1]) if refuse else bytes([request[6], 2, 1, 0b10])
                reply = request[:4] + len(body).to_bytes(2, "big") + body
                for part in (reply[:5], reply[5:]):
                    writer.write(part)
                    await writer.drain()
                    await asyncio.sleep(0.002)
        except ConnectionError:
            pass
        writer.close()

    async def scene() -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(keys / "module.pem", keys / "module.key")
        server = await asyncio.start_server(take, HOST, 0, ssl=context)
        url = "tls://{}:{}".format(*server.sockets[0].getsockname())
        async with opened(url, **tls_settings(keys, module="WAGO-750", poll_period_s=0.02)) as subject:
            await asyncio.sleep(0.1)
            assert (await newest(subject)).value.levels == (False, True)
            assert subject.health()["failures"] == 0
        server.close()
        await asyncio.sleep(0.05)

    asyncio.run(scene())
