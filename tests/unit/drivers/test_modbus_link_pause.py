"""A Modbus link in a process that stands still."""

import asyncio
import socket
import threading

from cell.clock import MonotonicClock
from drivers.modbus.address import parse_url
from drivers.modbus.link import LinkSettings, ModbusLink
from drivers.modbus.registers import Span, Table


def test_a_pause_of_this_process_does_not_count_against_the_module() -> None:
    """The answer comes after the pause, which was longer than the time for an answer."""
    over = threading.Event()

    def serve(listening: socket.socket) -> None:
        connection, _ = listening.accept()
        with connection:
            request = connection.recv(64)
            over.wait(20.0)
            threading.Event().wait(0.05)  # the timers that ran out meanwhile are served first
            connection.sendall(request[:4] + bytes([0, 5, 1, 3, 2, 0, 42]))
            connection.recv(64)

    def stand_still() -> None:
        threading.Event().wait(0.5)
        over.set()

    async def main(url: str) -> list[int]:
        settings = LinkSettings(url, parse_url(url), 1, 0.4, 10.0, "unit")
        link = ModbusLink("module", settings, MonotonicClock(), lambda: None)
        await link.connect()
        asyncio.get_running_loop().call_later(0.02, stand_still)
        try:
            return await link.read(Span(Table.HOLDING, 7, 1))
        finally:
            await link.close()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        serving = threading.Thread(target=serve, args=(listening,), daemon=True)
        serving.start()
        assert asyncio.run(main(f"tcp://127.0.0.1:{listening.getsockname()[1]}")) == [42]
        serving.join(20.0)


def test_on_a_serial_line_the_next_request_waits_until_a_late_reply_has_passed() -> None:
    told: list[str] = []

    class Clock(MonotonicClock):
        async def sleep(self, seconds: float) -> None:
            await asyncio.sleep(0.0)
            told.append("late replies passed")

    class Silent:
        async def read_holding_registers(self, start: int, **_: object) -> object:
            told.append(f"asked for {start}")
            await asyncio.sleep(60.0)
            return None

    async def main() -> None:
        url = "rtu:///dev/none?baudrate=9600"
        settings = LinkSettings(url, parse_url(url), 1, 0.01, 1.0, "unit")
        link = ModbusLink("module", settings, Clock(), lambda: None)
        link._client = Silent()
        asked = [link.read(Span(Table.HOLDING, start, 1)) for start in (1, 2)]
        results = await asyncio.gather(*asked, return_exceptions=True)
        assert [type(r).__name__ for r in results] == ["NoAnswer", "NoAnswer"]

    asyncio.run(main())
    assert told == ["asked for 1", "late replies passed", "asked for 2", "late replies passed"]
