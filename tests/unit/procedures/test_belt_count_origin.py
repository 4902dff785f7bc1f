"""A count that no belt can reach is a jump; wraps, restarts, positions set to zero and silences are none."""

from dataclasses import dataclass
from typing import Any, cast

import pytest

from cell.devices import Encoder, EncoderState
from cell.samples import Sample, Stream
from drivers.can_encoder.counts import Unwrap
from fakes.object import VirtualClock
from procedures.belt.count_origin import CountOrigin

M_PER_COUNT, PERIOD_S, MODULUS = 1e-4, 0.005, 65536
BELT = {"m_per_count": M_PER_COUNT, "dir": [1.0, 0.0, 0.0]}


@dataclass
class Positions:
    """What an encoder's positions, one a period, make of a :class:`CountOrigin`."""

    belt: dict[str, Any] | None

    def __post_init__(self) -> None:
        self.counts: Stream[EncoderState] = Stream("belt", VirtualClock())
        self.name, self.modulus = "belt", MODULUS
        self.unwrap, self.t = Unwrap(MODULUS), 0.0
        self.told: list[str] = []
        self.subject = CountOrigin(
            cast(Encoder, self), self.belt, lambda event, **what: self.told.append(event)
        )

    def send(self, *raw: int, after_s: float = PERIOD_S) -> list[bool]:
        moved = []
        for position in raw:
            self.t += after_s
            state = EncoderState(self.unwrap.take(position % MODULUS), position % MODULUS)
            moved.append(self.subject.moved(Sample(state, self.t, 0.0, 0)))
        return moved


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_farther_than_the_fastest_belt_is_a_jump_with_its_way(sign: float) -> None:
    encoder = Positions({**BELT, "m_per_count": sign * M_PER_COUNT})
    assert not any(encoder.send(20000, 20010, 20020))
    assert encoder.send(20800, 20810) == [True, False]
    assert encoder.subject.jumps == [pytest.approx(sign * 0.078)]
    assert encoder.told == ["encoder jump"]
    assert encoder.subject.changed is not None
    assert encoder.subject.changed.name == "ENCODER_JUMP"
    assert "0.035 m is the most at 5 m/s" in str(encoder.subject.changed)


def test_belts_as_fast_as_they_come_wraps_and_silences_are_none() -> None:
    encoder = Positions(BELT)
    fastest = range(60000, 60000 + 250 * 400, 250)  # 5 m/s, over the range's end
    assert not any(encoder.send(*fastest))
    assert not any(encoder.send(fastest[-1] - 20000, after_s=0.5)), "what was not sent is way, too"
    assert encoder.told == []
    assert encoder.subject.changed is None


def test_a_restart_and_a_position_set_to_zero_count_anew_and_are_not_accused() -> None:
    encoder = Positions(BELT)
    encoder.send(20000, 20010)
    encoder.counts.new_epoch()
    encoder.unwrap = Unwrap(MODULUS)
    assert encoder.send(40000, 40010) == [True, False]
    assert encoder.send(7, 17) == [True, False]
    assert encoder.told == ["counts begin anew"] * 2
    assert encoder.subject.jumps == []
    assert encoder.subject.changed is not None
    assert encoder.subject.changed.name == "DEVICE_LOST"


def test_a_position_set_to_zero_is_not_accused_where_the_belt_counts_down() -> None:
    encoder = Positions(BELT)
    assert not any(encoder.send(20000, 19992, 19985))
    assert encoder.send(-3, -11) == [True, False]
    assert encoder.told == ["counts begin anew"]
    assert encoder.subject.jumps == []


def test_without_a_known_scale_only_a_restart_is_seen() -> None:
    encoder = Positions(None)
    assert not any(encoder.send(100, 30000))
    encoder.counts.new_epoch()
    assert encoder.send(100) == [True]
