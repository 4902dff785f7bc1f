"""Stamps of a camera and an encoder, earlier by what a measured delay is above what the driver takes off."""

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import pytest

from cell.corrected_stamps import CorrectedCamera, CorrectedEncoder
from cell.devices import DepthCamera, Encoder, EncoderState, Frame, Intrinsics
from cell.samples import Sample, Stream

LATE_S = 0.015


class HandClock:
    t = 0.0

    def now(self) -> float:
        return self.t

    async def sleep(self, seconds: float) -> None:
        self.t += seconds


def frame(t: float, seq: int = 0) -> Frame:
    return Frame(seq, t, 0.004, Intrinsics(640, 480, (600.0, 600.0, 320.0, 240.0)), None, "9999", None, None)


class Camera:
    name = "camera"

    def __init__(self) -> None:
        self.clock = HandClock()
        self.frames: Stream[Frame] = Stream("camera.frames", self.clock)
        self.asked: list[float] = []

    async def capture(self, count: int, folder: Path, stem: str, after: float) -> Sequence[Frame]:
        self.asked.append(after)
        return [frame(after + 0.01 * k, k) for k in range(1, count + 1)]

    def health(self) -> dict[str, Any]:
        return {"frames": 7}


def test_every_way_to_a_frame_gives_the_earlier_stamp() -> None:
    camera = Camera()
    subject = CorrectedCamera(cast(DepthCamera, camera), LATE_S)
    heard: list[Sample[Frame]] = []
    subject.frames.subscribe(heard.append)
    for k in range(4):
        camera.frames.push(Sample(frame(1.0 + 0.1 * k, k), 1.0 + 0.1 * k, 0.002, k))
    last = subject.frames.last()
    assert last is not None
    assert last.t == last.value.t_exposure == 1.3 - LATE_S
    assert [s.t for s in heard] == [1.0 + 0.1 * k - LATE_S for k in range(4)]
    assert all(s.value.t_exposure == s.t for s in heard)
    within = subject.frames.between(1.1 - LATE_S, 1.2 - LATE_S)
    assert [s.seq for s in within] == [1, 2]
    assert subject.health() == {"frames": 7}


def test_a_frame_that_is_taken_was_truly_exposed_after_what_was_asked() -> None:
    camera = Camera()
    subject = CorrectedCamera(cast(DepthCamera, camera), LATE_S)
    taken = asyncio.run(subject.capture(2, Path("nowhere"), "pose", after=5.0))
    assert camera.asked == [5.0 + LATE_S]
    assert [f.t_exposure for f in taken] == pytest.approx([5.01, 5.02])


def test_the_age_of_a_count_goes_by_the_stamp_of_the_device() -> None:
    clock = HandClock()

    class Counter:
        name, modulus, period_s = "belt", 65536, 0.005
        counts: Stream[EncoderState] = Stream("belt.counts", clock)

    subject = CorrectedEncoder(cast(Encoder, Counter()), LATE_S)
    Counter.counts.push(Sample(EncoderState(5, 5), 2.0, 0.0, 0))
    Counter.counts.push(Sample(EncoderState(6, 6), 2.5, 0.0, 1))
    clock.t = 2.51
    sample = subject.counts.latest(0.011)
    assert (sample.t, sample.value.count) == (2.5 - LATE_S, 6)
    assert subject.counts.last_gap == (2.0 - LATE_S, 2.5 - LATE_S)
    assert (subject.modulus, subject.period_s) == (65536, 0.005)
