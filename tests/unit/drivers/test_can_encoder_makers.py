"""Encoders whose dictionaries are as their makers' manuals print them are all brought to sending.

What a manual's table does not say is filled in as CiA 301 and CiA 406 have it. No such device was here.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError
from drivers.can_encoder.config import CanopenEncoderConfig
from drivers.can_encoder.sdo import SdoClient
from drivers.can_encoder.setup import NodeSetup, set_up
from fakes.can.objects import OUT_OF_RANGE, Dictionary, Entry, SdoRefusal, constant

NODE = 5


class Value:
    """A value of the dictionary, which may take some numbers only."""

    def __init__(self, size: int, value: int, takes: Sequence[int] | None = None) -> None:
        self.value, self._takes = value, takes
        self.entry = Entry(size, lambda: self.value, self._set)

    def _set(self, value: int) -> None:
        if self._takes is not None and value not in self._takes:
            raise SdoRefusal(OUT_OF_RANGE)
        self.value = value


@dataclass
class Manual:
    """What a manual says; sizes in bytes, 0 where the object is not there."""

    event_timer: int = 2
    inhibit: int = 2
    cyclic_timer: int = 0  # 6200h
    types: tuple[int, ...] = (0, 1, 254, 255)
    kind: int = 1  # transmission type as delivered
    operating: int = 2  # 6000h
    range_counts: int | None = 1 << 25  # None: no 6002h
    mapped: tuple[int, ...] = (0x60040020,)
    values: dict[str, Value] = field(default_factory=dict)

    def dictionary(self) -> Dictionary:
        out, v = Dictionary(), self.values
        out.add(0x1000, constant(4, 0x0002_0196))
        out.add(0x1018, constant(1, 4), *(constant(4, n) for n in (0x99, 1, 0x10001, 999966001)))
        v["beat"], v["cob"], v["type"] = Value(2, 0), Value(4, 0x180 + NODE), Value(1, self.kind, self.types)
        out.add(0x1017, v["beat"].entry)
        subs = {0: constant(1, 5), 1: v["cob"].entry, 2: v["type"].entry}
        for name, sub, size in (("inhibit", 3, self.inhibit), ("event", 5, self.event_timer)):
            if size:
                v[name] = Value(size, 0)
                subs[sub] = v[name].entry
        out.add_subs(0x1800, subs)
        out.add(0x1A00, constant(1, len(self.mapped)), *(constant(4, entry) for entry in self.mapped))
        v["operating"] = Value(self.operating, 4)
        out.add(0x6000, v["operating"].entry)
        out.add(0x6001, Value(4, 8192).entry)
        if self.range_counts is not None:
            v["range"] = Value(4, self.range_counts)
            out.add(0x6002, v["range"].entry)
        out.add(0x6004, constant(4, 0))
        if self.cyclic_timer:
            v["cyclic"] = Value(self.cyclic_timer, 0)
            out.add(0x6200, v["cyclic"].entry)
        return out


MAKERS = {
    # BEI Sensors, CANopen manual serie M, version 07/10, page 34: both times of 1800h are UNSIGNED32.
    "BEI Sensors MHK5, MHM5": lambda: Manual(event_timer=4, inhibit=4),
    # BEI Ideacod, Posi+ CANopen user manual 1.02, pages 19 and 22.
    "BEI Ideacod THK5, THM5": lambda: Manual(cyclic_timer=2, range_counts=1 << 29),
    # Fritz Kuebler, 9080 series, page 20: a cyclic timer 6200h, and no timer in 1800h.
    "Kuebler 9080": lambda: Manual(event_timer=0, inhibit=0, cyclic_timer=2, kind=254),
    # Fritz Kuebler, CANlift manual, page 13: 254 and 255 with an event timer, mapping that can be changed.
    "Kuebler Sendix": lambda: Manual(types=(*range(1, 241), 252, 253, 254, 255), kind=255),
    # ASM, MAN-PRDS-E-17, page 24: no 6002h, a cyclic timer of 100 ms as delivered.
    "ASM Posirot PRDS": lambda: Manual(event_timer=0, inhibit=0, cyclic_timer=2, range_counts=None),
    # TR-Electronic delivers 255; one that takes nothing else.
    "TR-Electronic": lambda: Manual(types=(255,), kind=255),
}


def configured(manual: Manual, **keys: Any) -> NodeSetup:
    dictionary = manual.dictionary()

    async def whole() -> NodeSetup:
        async def send(identifier: int, data: bytes) -> None:
            if identifier == 0x600 + NODE and (reply := dictionary.serve(data)) is not None:
                asyncio.get_running_loop().call_soon(sdo.receive, reply)

        sdo = SdoClient("belt", NODE, send, 0.2)
        config = CanopenEncoderConfig.model_validate({"bus": "socketcan:can0", "node": NODE, **keys})
        return await set_up("belt", config, sdo, send, MonotonicClock())

    return asyncio.run(whole())


@pytest.mark.parametrize("maker", MAKERS)
def test_an_encoder_as_its_manual_has_it_is_configured(maker: str) -> None:
    manual = MAKERS[maker]()
    keys = {"range_counts": 16384} if manual.range_counts is None else {}
    found = configured(manual, period_s=0.004, **keys)
    values = manual.values
    assert found.position == slice(0, 4)
    assert found.modulus == (manual.range_counts or 16384)
    assert values["type"].value in (254, 255)
    assert not found.by_sync
    assert values["event" if manual.event_timer else "cyclic"].value == 4
    if manual.inhibit:
        assert values["inhibit"].value == 39  # tenths of a millisecond, one less than the period
    assert values["cob"].value == 0x180 + NODE


def test_an_encoder_that_takes_no_timer_is_asked_by_sync() -> None:
    manual = Manual(types=(0, 1, 2), event_timer=0)
    assert configured(manual).by_sync
    assert manual.values["type"].value == 1


def test_a_range_of_all_32_bits_is_told_and_written_as_zero() -> None:
    assert configured(Manual(range_counts=0)).modulus == 1 << 32
    manual = Manual()
    assert configured(manual, range_counts=1 << 32).modulus == 1 << 32
    assert manual.values["range"].value == 0


def test_an_encoder_that_does_not_tell_its_range_needs_it_configured() -> None:
    with pytest.raises(CellError, match="set range_counts to the one in its manual") as caught:
        configured(Manual(range_counts=None))
    assert caught.value.name == "ENCODER_RANGE"


def test_operating_parameters_of_four_bytes_are_written_as_such() -> None:
    manual = Manual(operating=4)
    configured(manual, range_counts=20000)
    assert manual.values["operating"].value & 4


def test_a_bus_that_the_frames_would_fill_is_refused_before_it_is_there() -> None:
    with pytest.raises(ValueError, match="would fill 108 % of a bus with 125000 bit/s"):
        CanopenEncoderConfig.model_validate(
            {"bus": "slcan:/dev/ttyACM0@125000", "node": 5, "period_s": 0.001}
        )
