"""Bringing a CiA 406 node to sending: what is written in which order, and devices that are not as usual."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError
from drivers.can_encoder.config import CanopenEncoderConfig
from drivers.can_encoder.sdo import SdoClient
from drivers.can_encoder.setup import NodeSetup, set_up
from fakes.can.bus import CanBus, Frame
from fakes.can.node import POSITION, SPEED, EncoderNode, State
from fakes.can.objects import Entry, constant
from tests.kit.can_rig import NODE, SERIAL, TestShaft

pytestmark = pytest.mark.wire  # answers are waited for in real time

Change = Callable[[EncoderNode], None]


def configure(change: Change = lambda node: None, **keys: Any) -> tuple[NodeSetup, EncoderNode, list[Frame]]:
    """Set up a node that ``change`` has made unusual; frames that we sent come back too."""
    sent: list[Frame] = []

    async def whole() -> tuple[NodeSetup, EncoderNode]:
        bus = CanBus()
        node = EncoderNode(bus, NODE, SERIAL, TestShaft(modulus=30000), time.monotonic)
        config = CanopenEncoderConfig.model_validate(
            {"bus": "socketcan:can0", "node": NODE, "connect_timeout_s": 0.05, **keys}
        )

        async def send(identifier: int, data: bytes) -> None:
            sent.append(Frame(identifier, data))
            port.send(sent[-1], time.monotonic())

        def receive(frame: Frame, t: float) -> None:
            if frame.id == 0x580 + NODE:
                asyncio.get_running_loop().call_soon(sdo.receive, frame.data)

        port = bus.join(receive)
        sdo = SdoClient("belt", NODE, send, 0.01)
        node.power_on()
        try:
            change(node)
            found = await set_up("belt", config, sdo, send, MonotonicClock())
            return found, node
        finally:
            state = node.state
            node.power_off()
            node.state = state

    found, node = asyncio.run(whole())
    return found, node, sent


def refused(name: str, said: str, change: Change = lambda node: None, **keys: Any) -> None:
    with pytest.raises(CellError, match=said) as caught:
        configure(change, **keys)
    assert caught.value.name == name


def value(node: EncoderNode, index: int, sub: int = 0) -> int:
    return node.objects.find(index, sub).read()


def replace(index: int, sub: int, entry: Entry | None) -> Change:
    """A node whose object is another one, or is missing."""

    def change(node: EncoderNode) -> None:
        entries = node.objects._entries.setdefault(index, {})
        if entry is None:
            entries.pop(sub, None)
        else:
            entries[sub] = entry

    return change


def test_a_node_as_delivered_sends_its_position_by_the_timer_and_beats() -> None:
    found, node, sent = configure(period_s=0.004, heartbeat_s=0.1)
    assert node.state is State.OPERATIONAL
    assert found.modulus == 30000
    assert found.position == slice(0, 4)
    assert found.speed is None
    assert found.heartbeat
    assert found.identity.serial == str(SERIAL)
    assert found.identity.is_twin
    assert value(node, 0x1800, 1) & 0x1FFFFFFF == 0x180 + NODE
    assert value(node, 0x1800, 5) == 4
    assert value(node, 0x1017) == 100
    assert [frame.data for frame in sent if frame.id == 0] == [bytes([0x80, NODE]), bytes([1, NODE])]


def test_the_object_is_off_while_it_is_mapped() -> None:
    """CiA 301, 7.5.2.36; the twin's node refuses any other order."""
    found, node, sent = configure(speed=True, cob_id=0x1F0)
    assert found.speed == slice(4, 6)
    assert [value(node, 0x1A00, k) for k in range(3)] == [2, POSITION, SPEED]
    assert value(node, 0x1800, 1) & 0x1FFFFFFF == 0x1F0
    writes = [(frame.data[1:4], frame.data[4:]) for frame in sent if frame.data[0] >> 5 == 1]
    cob_id = [int.from_bytes(data, "little") for place, data in writes if place == b"\x00\x18\x01"]
    assert [bool(x >> 31) for x in cob_id] == [True, False]


def test_the_second_object_may_carry_the_position_by_the_timer() -> None:
    found, node, _ = configure(tpdo=2)
    assert found.position == slice(0, 4)
    assert value(node, 0x1801, 1) & 0x1FFFFFFF == 0x280 + NODE
    assert value(node, 0x1801, 2) == 254
    assert value(node, 0x1801, 5) == 5


def test_a_range_that_is_wished_for_is_written_and_read_back() -> None:
    found, node, _ = configure(range_counts=20000, units_per_revolution=8192)
    assert found.modulus == 20000
    assert value(node, 0x6002) == 20000
    refused("ENCODER_RANGE", "wanted are 20000", replace(0x6002, 0, Entry(4, lambda: 7000, lambda v: None)),
            range_counts=20000)  # fmt: skip
    refused("ENCODER_RANGE", "range of 1 counts", replace(0x6002, 0, constant(4, 1)))
    refused("ENCODER_REFUSED", "6001h:00h: value out of range", units_per_revolution=100)


def test_an_older_encoder_has_its_timer_elsewhere() -> None:
    _, node, _ = configure(replace(0x1800, 5, None), period_s=0.008)
    assert value(node, 0x6200) == 8


def test_a_timer_that_is_rounded_by_the_device_is_not_accepted_in_silence() -> None:
    refused("ENCODER_REFUSED", "10 ms instead of 4 ms",
            replace(0x1800, 5, Entry(2, lambda: 10, lambda v: None)), period_s=0.004)  # fmt: skip


def test_a_fixed_mapping_is_taken_as_it_is_when_the_position_is_in_it() -> None:
    def change(node: EncoderNode) -> None:
        replace(0x1A00, 0, constant(1, 2))(node)
        replace(0x1A00, 1, constant(4, SPEED))(node)
        replace(0x1A00, 2, constant(4, POSITION))(node)

    found, _, _ = configure(change)
    assert found.position == slice(2, 6)
    assert found.speed == slice(0, 2)


def test_a_fixed_mapping_without_the_position_is_refused() -> None:
    def change(node: EncoderNode) -> None:
        replace(0x1A00, 0, constant(1, 1))(node)
        replace(0x1A00, 1, constant(4, SPEED))(node)

    refused("ENCODER_REFUSED", "not carry the position 6004h; object 1A00h:00h: the object can only", change)


def test_a_node_without_a_heartbeat_is_used_without_one() -> None:
    found, _, _ = configure(lambda node: node.objects._entries.pop(0x1017) and None)
    assert not found.heartbeat


def test_a_node_without_a_serial_number_has_none() -> None:
    found, _, _ = configure(replace(0x1018, 4, None))
    assert found.identity.serial == ""
    assert not found.identity.is_twin


def test_a_node_that_is_no_encoder_is_told_and_left_alone() -> None:
    sent: list[Frame] = []

    def change(node: EncoderNode) -> None:
        replace(0x1000, 0, constant(4, 0x0003_0191))(node)

    with pytest.raises(CellError, match="device profile 401, an encoder has 406") as caught:
        _, _, sent = configure(change)
    assert caught.value.name == "ENCODER_OTHER_DEVICE"
    assert sent == []


def test_a_node_that_does_not_answer_cannot_be_reached() -> None:
    refused("DEVICE_UNREACHABLE", f"no node {NODE} answers on socketcan:can0", lambda node: node.power_off())


def test_a_node_that_was_stopped_is_brought_back() -> None:
    def change(node: EncoderNode) -> None:
        node.state = State.STOPPED

    _, node, _ = configure(change)
    assert node.state is State.OPERATIONAL
