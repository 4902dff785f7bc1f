"""An encoder as its maker builds it: positions older than their message, and told when they change."""

import asyncio
import itertools
import time

import numpy as np
import pytest

from fakes.can.bus import CanBus, Frame
from fakes.can.node import EncoderNode
from fakes.world.belt.belt import Belt
from fakes.world.belt.encoder import BeltEncoder
from fakes.world.belt.truth import BeltTruth
from tests.kit.can_rig import NODE, SERIAL, TestShaft

INHIBIT_S, TIMER_S = 0.005, 0.02


def test_a_position_is_older_than_its_message_by_less_than_the_jitter_and_two_looks_agree() -> None:
    truth = BeltTruth(jitter_s=0.002)
    subject = BeltEncoder(truth, Belt(truth, 1, 0.0), 0.0)
    late = np.array([t - subject.told(t) for t in np.arange(1.0, 3.0, 0.005)])
    assert 0.0 <= late.min() < 0.0005
    assert 0.0015 < late.max() <= 0.002
    assert subject.told(1.234) == subject.told(1.234)


@pytest.mark.parametrize(
    ("speed", "timer_s", "least_s"),
    [(1000.0, TIMER_S, INHIBIT_S), (0.0, TIMER_S, TIMER_S), (0.0, 0.006, INHIBIT_S)],
    ids=["moving", "standing", "standing, the timer just behind the inhibit time"],
)
def test_a_new_position_is_told_as_soon_as_the_inhibit_time_allows_and_an_old_one_by_the_timer(
    speed: float, timer_s: float, least_s: float
) -> None:
    heard: list[float] = []

    async def scene() -> None:
        bus = CanBus()
        port = bus.join(lambda frame, t: heard.append(t) if frame.id == 0x180 + NODE else None)
        node = EncoderNode(bus, NODE, SERIAL, TestShaft(speed), time.monotonic, by_events=True)
        node.power_on()
        tpdo = node._tpdos[0]
        tpdo.inhibit, tpdo.timer_ms = round(1e4 * INHIBIT_S), round(1e3 * timer_s)
        port.send(Frame(0, bytes([1, NODE])), time.monotonic())
        await asyncio.sleep(0.15)
        node.power_off()

    asyncio.run(scene())
    steps = [b - a for a, b in itertools.pairwise(heard)]
    assert len(steps) > 2
    assert min(steps) == pytest.approx(least_s, abs=1e-6)
