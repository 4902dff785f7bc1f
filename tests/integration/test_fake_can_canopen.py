"""The twin's CANopen node under a CANopen client that we did not write."""

import asyncio
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import canopen
import pytest
from canopen.objectdictionary import ODRecord, ODVariable, datatypes

from tests.kit.can_rig import NODE, SERIAL, CanRig, TestShaft, can_rig

pytestmark = pytest.mark.wire
HOST = "127.0.51.3"
INTERFACES = ("slcan", "socketcand")


def dictionary() -> canopen.ObjectDictionary:
    """What the client must know of a CiA 406 encoder, from the standards."""
    found = canopen.ObjectDictionary()
    variables = {
        0x1000: datatypes.UNSIGNED32,
        0x1001: datatypes.UNSIGNED8,
        0x1005: datatypes.UNSIGNED32,
        0x1017: datatypes.UNSIGNED16,
        0x6000: datatypes.UNSIGNED16,
        0x6002: datatypes.UNSIGNED32,
        0x6003: datatypes.UNSIGNED32,
        0x6004: datatypes.UNSIGNED32,
        0x6200: datatypes.UNSIGNED16,
        0x6FFF: datatypes.UNSIGNED32,
    }
    for index, kind in variables.items():
        entry = ODVariable(f"object {index:04X}", index)
        entry.data_type = kind
        found.add_object(entry)
    records = {
        0x1018: [datatypes.UNSIGNED8, *[datatypes.UNSIGNED32] * 4],
        **{
            index: [
                datatypes.UNSIGNED8,
                datatypes.UNSIGNED32,
                datatypes.UNSIGNED8,
                datatypes.UNSIGNED16,
                None,
                datatypes.UNSIGNED16,
            ]
            for index in (0x1800, 0x1801)
        },
        **{index: [datatypes.UNSIGNED8, *[datatypes.UNSIGNED32] * 4] for index in (0x1A00, 0x1A01)},
        0x6030: [datatypes.UNSIGNED8, datatypes.INTEGER16],
    }
    for index, kinds in records.items():
        record = ODRecord(f"object {index:04X}", index)
        for sub, kind in enumerate(kinds):
            if kind is not None:
                entry = ODVariable(f"sub {sub}", index, sub)
                entry.data_type = kind
                record.add_member(entry)
        found.add_object(record)
    return found


class Client:
    """A network of the canopen library with our node on it; used from its own thread."""

    def __init__(self, rig: CanRig, interface: str) -> None:
        self.network = canopen.Network()
        self.node = canopen.RemoteNode(NODE, dictionary())
        self.node.sdo.RESPONSE_TIMEOUT = 1.0
        bus = rig.wires.buses[interface].partition(":")[2]
        if interface == "slcan":
            path = bus.partition("@")[0]
            self._place: dict[str, Any] = {"channel": path, "bitrate": 250000, "sleep_after_open": 0}
        else:
            address, _, channel = bus.partition("/")
            host, _, port = address.partition(":")
            self._place = {"channel": channel, "host": host, "port": int(port)}
        self._interface = interface

    def __enter__(self) -> "Client":
        self.network.connect(interface=self._interface, **self._place)
        self.network.add_node(self.node)
        return self

    def __exit__(self, *_: object) -> None:
        self.network.disconnect()

    def raw(self, index: int, sub: int | None = None) -> int:
        found = self.node.sdo[index] if sub is None else self.node.sdo[index][sub]
        return int(found.raw)


def play(interface: str, work: Callable[[Client, CanRig], None], shaft: TestShaft | None = None) -> None:
    """Run ``work`` in a thread beside the node's loop."""

    async def scene() -> None:
        async with can_rig(HOST, shaft) as rig:

            def whole() -> None:
                with Client(rig, interface) as client:
                    work(client, rig)

            await asyncio.to_thread(whole)

    asyncio.run(scene())


@pytest.fixture(params=INTERFACES)
def interface(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_the_client_reads_who_the_node_is_and_where_it_stands(interface: str) -> None:
    def work(client: Client, rig: CanRig) -> None:
        assert client.raw(0x1000) & 0xFFFF == 406
        assert client.raw(0x1018, 4) == SERIAL
        assert client.raw(0x6002) == 65536
        client.node.sdo[0x6003].raw = 4000
        assert 0 <= client.raw(0x6004) - 4000 < 2000
        assert client.raw(0x6030, 1) == 1000

    play(interface, work)


def test_the_client_is_told_why_a_request_is_refused(interface: str) -> None:
    def refused(code: int, act: Callable[[], Any]) -> None:
        with pytest.raises(canopen.SdoAbortedError) as caught:
            act()
        assert caught.value.code == code

    def work(client: Client, rig: CanRig) -> None:
        sdo = client.node.sdo
        refused(0x06020000, lambda: client.raw(0x6FFF))
        refused(0x06090011, lambda: sdo.upload(0x1018, 9))
        refused(0x06010002, lambda: sdo.download(0x6004, 0, bytes(4)))
        refused(0x06070010, lambda: sdo.download(0x1017, 0, bytes(4)))
        refused(0x06090030, lambda: sdo.download(0x6002, 0, (3).to_bytes(4, "little")))
        refused(0x08000022, lambda: sdo.download(0x1A00, 1, (0x60040020).to_bytes(4, "little")))

    play(interface, work)


def test_the_client_maps_position_and_speed_and_gets_them_by_the_timer(interface: str) -> None:
    def work(client: Client, rig: CanRig) -> None:
        node, got = client.node, []
        node.nmt.state = "PRE-OPERATIONAL"
        node.tpdo.read()
        tpdo = node.tpdo[1]
        assert [v.index for v in tpdo] == [0x6004]
        tpdo.clear()
        tpdo.add_variable(0x6004, 0)
        tpdo.add_variable(0x6030, 1)
        tpdo.trans_type, tpdo.event_timer, tpdo.enabled = 254, 10, True
        node.tpdo.save()
        node.tpdo.read()
        assert [(v.index, v.length) for v in node.tpdo[1]] == [(0x6004, 32), (0x6030, 16)]
        enough = threading.Event()

        def take(pdo: Any) -> None:
            got.append((pdo.timestamp, pdo[0].raw, pdo[1].raw))
            if len(got) >= 30:
                enough.set()

        node.tpdo[1].add_callback(take)
        node.nmt.state = "OPERATIONAL"
        assert enough.wait(5.0)
        assert all(speed == 1000 for _, _, speed in got)
        steps = [b[1] - a[1] for a, b in pairwise(got)]
        assert all(9 <= step <= 11 for step in steps), "10 ms at 1000 counts a second"

    play(interface, work)


def test_a_synchronous_object_is_sent_at_each_sync_and_only_while_operational(interface: str) -> None:
    def work(client: Client, rig: CanRig) -> None:
        node, got = client.node, []
        node.nmt.state = "PRE-OPERATIONAL"
        node.tpdo.read()
        node.tpdo[2].add_callback(lambda pdo: got.append(pdo[0].raw))
        client.network.sync.transmit()
        time.sleep(0.1)
        assert got == []
        node.nmt.state = "OPERATIONAL"
        for count in (1, 2, 3):
            client.network.sync.transmit()
            assert _within(2.0, lambda count=count: len(got) == count)
        node.nmt.state = "STOPPED"
        client.network.sync.transmit()
        time.sleep(0.1)
        assert len(got) == 3

    play(interface, work)


def test_heartbeat_boot_up_and_emergencies_are_what_the_client_expects(interface: str) -> None:
    def work(client: Client, rig: CanRig) -> None:
        node = client.node
        node.sdo[0x1017].raw = 20
        assert node.nmt.wait_for_heartbeat(2.0) == "PRE-OPERATIONAL"
        node.nmt.state = "OPERATIONAL"
        assert _within(2.0, lambda: node.nmt.wait_for_heartbeat(2.0) == "OPERATIONAL")
        _on_loop(rig, lambda: rig.node.alarm(0x8120, 0x11))
        assert _within(2.0, lambda: [(e.code, e.register) for e in node.emcy.log] == [(0x8120, 0x11)])
        assert client.raw(0x1001) == 0x11
        states: list[int] = []
        node.nmt.add_heartbeat_callback(states.append)
        node.nmt.state = "RESET"
        assert _within(2.0, lambda: 0 in states), "the boot-up message"
        assert client.raw(0x1017) == 0, "settings are as delivered again"
        assert rig.shaft.marks == [("restart", 0)]

    loop_of: dict[str, asyncio.AbstractEventLoop] = {}

    def _on_loop(rig: CanRig, act: Callable[[], None]) -> None:
        loop_of["loop"].call_soon_threadsafe(act)

    async def scene() -> None:
        loop_of["loop"] = asyncio.get_running_loop()
        async with can_rig(HOST) as rig:

            def whole() -> None:
                with Client(rig, interface) as client:
                    work(client, rig)

            await asyncio.to_thread(whole)

    asyncio.run(scene())


def _within(seconds: float, found: Callable[[], bool]) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found():
            return True
        time.sleep(0.005)
    return False
