"""The faults of the input module's wires, as the switchboard of the twin begins and ends them."""

import asyncio
import socket
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import pytest

from cell.errors import CellError
from fakes.faults.vocabulary import Fault
from fakes.modbus_io import ModuleFaults
from tests.kit.modbus_io_rig import RawClient, Rig, mbap, rig

pytestmark = pytest.mark.wire
LEVELS, ANSWER = "0200000003", "020105"
SERIAL = "2b0e0480"


def talk(script: Callable[[Rig, RawClient], Awaitable[None]]) -> None:
    async def scene() -> None:
        async with rig() as subject, await RawClient.open(subject.address) as client:
            assert await client.ask(LEVELS) == ANSWER
            await script(subject, client)

    asyncio.run(scene())


async def accepts(subject: Rig) -> bool:
    """Whether a new connection is answered."""
    try:
        async with await RawClient.open(subject.address) as client:
            return await client.ask(LEVELS) == ANSWER
    except ConnectionError:
        return False


async def until_accepted(subject: Rig, seconds: float = 10.0) -> float:
    begun = time.monotonic()
    async with asyncio.timeout(seconds):
        while True:
            if await accepts(subject):
                break
            await asyncio.sleep(0.005)
    return time.monotonic() - begun


def test_refuse_cuts_and_keeps_out_until_cleared() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject("refuse")
        assert await client.ended() == "FIN"
        assert not await accepts(subject)
        subject.inject("clear")
        await until_accepted(subject)

    talk(script)


def test_refuse_ends_by_itself_after_its_time_and_a_later_one_has_its_own() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject("refuse", for_s=0.05)
        subject.inject("refuse", for_s=0.25)
        assert await until_accepted(subject) > 0.2

    talk(script)


@pytest.mark.parametrize("fault", ["refuse", "reboot"])
def test_a_connection_on_its_way_when_the_listener_closes_is_not_served(fault: str) -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        late = await asyncio.to_thread(socket.create_connection, subject.address)
        subject.inject(fault)
        late.setblocking(False)
        try:
            await asyncio.get_running_loop().sock_sendall(late, mbap(1, LEVELS))
            async with asyncio.timeout(5.0):
                assert await asyncio.get_running_loop().sock_recv(late, 100) == b""
        except ConnectionError:
            pass
        finally:
            late.close()
        assert len(subject.wires.connections) == 0

    talk(script)


@pytest.mark.parametrize(("fault", "end"), [("drop", "FIN"), ("reset", "RST")])
def test_drop_and_reset_end_connections_and_new_ones_are_welcome(fault: str, end: str) -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject(fault)
        assert await client.ended() == end
        assert await accepts(subject)

    talk(script)


@pytest.mark.parametrize("fault", ["half-open", "silence"])
def test_half_open_and_silence_answer_nothing_and_keep_the_connection(fault: str) -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject(fault)
        client.put(LEVELS)
        assert await client.silent()
        subject.inject("clear")
        assert await client.silent(0.02), "what was asked meanwhile is not answered later"
        assert await client.ask(LEVELS) == ANSWER

    talk(script)


def test_delay_holds_back_the_reply_and_not_the_reading() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject("delay", s=0.1, for_s=1.0)
        begun = time.monotonic()
        client.put(LEVELS)
        assert await client.silent(0.08)
        assert (await client.reply())[2] == ANSWER
        assert 0.1 <= time.monotonic() - begun < 0.5
        subject.inject("clear")
        assert await client.ask(LEVELS, timeout=0.08) == ANSWER

    talk(script)


def test_split_sends_a_reply_in_two_segments() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject("split")
        client.put(LEVELS)
        first = await client.reader.read(100)
        assert 0 < len(first) < 10
        assert len(first + await client.reader.readexactly(10 - len(first))) == 10

    talk(script)


def test_duplicate_sends_each_reply_twice_and_junk_is_no_frame() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject("duplicate")
        client.put(LEVELS)
        assert await client.reply() == await client.reply() == (2, 1, ANSWER)
        subject.inject("clear")
        subject.inject("junk")
        assert await client.reader.readexactly(256) == bytes(range(256))
        assert await client.ask(LEVELS) == ANSWER

    talk(script)


def test_a_reboot_cuts_refuses_and_comes_back_with_counters_at_zero() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        assert await client.ask("0400000002") == "040400011170"
        subject.inject("reboot", boot_s=0.1)
        assert await client.ended() == "RST"
        assert not await accepts(subject)
        subject.inject("clear")
        assert not await accepts(subject), "clear does not make it boot faster"
        await until_accepted(subject)
        async with await RawClient.open(subject.address) as again:
            assert await again.ask("0400000002") == "040400000000"
            assert (await again.ask(SERIAL)).endswith(b"99993300001".hex())

    talk(script)


def test_a_reboot_may_bring_another_module_and_a_second_one_begins_the_wait_anew() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.inject("reboot", boot_s=0.05)
        subject.inject("reboot", boot_s=0.25, serial=99993300777)
        assert await until_accepted(subject) > 0.2
        async with await RawClient.open(subject.address) as again:
            assert (await again.ask(SERIAL)).endswith(b"99993300777".hex())

    talk(script)


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("delay", {"ms": 3}, "delay does not take ms; it takes for_s, s"),
        ("delay", {"s": "soon"}, "s='soon' is not a number"),
        ("delay", {"s": -1}, "s=-1 is not between"),
        ("drop", {"for_s": 1}, "drop does not take for_s; it takes nothing"),
        ("reboot", {"off_s": 1}, "reboot does not take off_s; it takes boot_s, serial"),
        ("reboot", {"serial": 1234}, "serial='1234': twin serials are digits that begin with 9999"),
        ("reboot", {"boot_s": float("nan")}, "boot_s=nan is not between"),
        ("melt", {}, "beams has no fault 'melt'"),
        ("gap", {}, "beams has no fault 'gap'"),
    ],
)
def test_what_a_fault_does_not_take_is_refused_by_name_and_nothing_begins(
    name: str, arguments: Mapping[str, Any], said: str
) -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        with pytest.raises(CellError, match=said) as caught:
            subject.inject(name, **arguments)
        assert caught.value.name == "ARGUMENT_INVALID"
        assert await client.ask(LEVELS, timeout=0.5) == ANSWER

    talk(script)


class Wiring:
    """Stands in for the inputs' own faults."""

    def __init__(self) -> None:
        self.heard: list[tuple[object, ...]] = []

    def offers(self) -> frozenset[Fault]:
        return frozenset({Fault.STUCK, Fault.WRAP})

    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        self.heard.append((fault, dict(arguments)))

    def clear(self) -> None:
        self.heard.append(("clear",))


def test_faults_of_the_inputs_are_passed_on_with_their_arguments() -> None:
    wiring = Wiring()

    async def script(subject: Rig, client: RawClient) -> None:
        subject.switchboard.devices["beams"] = ModuleFaults(subject.wires, wiring)
        subject.inject("stuck", input="xs", level=1)
        subject.inject("clear")

    talk(script)
    assert wiring.heard == [(Fault.STUCK, {"input": "xs", "level": 1}), ("clear",)]


def test_a_wrap_of_the_inputs_counters_shows_at_its_value_even_after_a_clear() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        subject.switchboard.devices["beams"] = ModuleFaults(subject.wires, Wiring())
        assert await client.ask("0f0000000101ff") == "0f00000001"
        assert await client.ask("0400000002") == "040400000000"
        subject.inject("wrap")
        assert await client.ask("0400000002") == "040400011170"

    talk(script)
