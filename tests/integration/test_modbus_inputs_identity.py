"""Who an input module says it is, against pymodbus' own server and pyModbusTCP's."""

import asyncio
from typing import Any

import pytest
from pyModbusTCP.server import DataBank, ModbusServer

from tests.integration.modbus_inputs_rig import HOST, Board, newest, opened, pymodbus_server

pytestmark = pytest.mark.wire


def test_a_module_tells_its_product_and_revision_by_function_43() -> None:
    async def scene() -> None:
        identity = {"VendorName": "Acme", "ProductCode": "DI-16", "MajorMinorRevision": "2.1"}
        async with pymodbus_server(Board(), identity) as url, opened(url, module="ioLogik-E1210") as subject:
            found = await subject.identify()
            assert (found.model, found.version, found.extra) == ("DI-16", "2.1", {"vendor": "Acme"})
            assert found.serial == ""
            assert not found.is_twin

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("place", "serial"),
    [
        ({"table": "input", "address": 61, "count": 3, "kind": "text"}, "AB123"),
        ({"table": "input", "address": 61, "count": 2, "kind": "number"}, str(0x41423132)),
        ({"table": "input", "address": 61, "count": 2, "word_order": "low-first"}, str(0x31324142)),
    ],
)
def test_a_serial_number_comes_from_registers_where_function_43_has_none(
    place: dict[str, Any], serial: str
) -> None:
    async def scene() -> None:
        async with pymodbus_server(Board("generic")) as url, opened(url, serial=place) as subject:
            found = await subject.identify()
            assert (found.model, found.serial) == ("generic", serial)

    asyncio.run(scene())


def test_the_server_of_pymodbustcp_is_read_and_has_no_function_43() -> None:
    port = 15021
    bank = DataBank(h_regs_size=64)
    bank.set_discrete_inputs(0, [True, False])
    server = ModbusServer(HOST, port, no_block=True, data_bank=bank)

    async def scene() -> None:
        await asyncio.to_thread(server.start)
        try:
            async with opened(f"tcp://{HOST}:{port}", unit=7) as subject:
                assert (await newest(subject)).value.levels == (True, False)
                bank.set_discrete_inputs(0, [False, True])
                seen = (await newest(subject)).value
                assert (seen.levels, seen.changes) == ((False, True), (1, 1))
                found = await subject.identify()
                assert (found.model, found.serial) == ("generic", "")
        finally:
            await asyncio.to_thread(server.stop)

    asyncio.run(scene())
