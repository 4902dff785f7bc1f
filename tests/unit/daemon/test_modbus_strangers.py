"""A client that may write keeps its connection, whatever strangers do."""

import asyncio
import logging
from contextlib import suppress

import pytest

from tests.kit.modbus_face_rig import HOST, Plant, connect, face_of, plant, run

__all__ = ["plant"]
pytestmark = pytest.mark.wire
STRANGER = "127.0.0.9"
POLL = bytes.fromhex("000100000006010400080001")


def test_strangers_that_poll_and_reconnect_never_take_the_place_of_the_plc(
    plant: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    subject = face_of(plant, allow_clients=[HOST])

    async def pester() -> None:
        while True:
            with suppress(OSError, asyncio.IncompleteReadError):
                reader, writer = await asyncio.open_connection(*subject.address, local_addr=(STRANGER, 0))
                try:
                    while True:
                        writer.write(POLL)
                        await reader.readexactly(11)
                        await asyncio.sleep(0.05)
                finally:
                    writer.transport.abort()
            await asyncio.sleep(0.05)

    async def scene() -> None:
        await subject.start()
        plc = await connect(subject)
        strangers = [asyncio.create_task(pester()) for _ in range(40)]
        try:
            for _ in range(20):
                assert await plc.ask("0400080001") == "04020100"
                await asyncio.sleep(0.05)
            second = await connect(subject)
            assert await second.ask("0400080001") == "04020100", "a place is kept"
            await second.close()
        finally:
            for task in strangers:
                task.cancel()
            await asyncio.wait(strangers)
            await plc.close()
            await subject.stop()

    with caplog.at_level(logging.INFO):
        run(scene())
    assert subject._server.turned_away > 0
    assert subject._server.evicted > 0
    assert len([r for r in caplog.records if r.name == "cellward.modbus"]) < 10


def test_an_eviction_and_a_stop_with_clients_leave_no_traceback(
    plant: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    async def scene() -> None:
        subject = face_of(plant, max_connections=2)
        await subject.start()
        clients = [await connect(subject) for _ in range(5)]
        assert await clients[-1].ask("0400080001") == "04020100"
        await subject.stop()
        for client in clients:
            await client.close()

    run(scene())
    assert [r for r in caplog.records if r.exc_info or r.name == "asyncio"] == []
