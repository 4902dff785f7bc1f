"""What every belt encoder promises, on every face."""

import asyncio
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np
import pytest

from cell.devices import Encoder, EncoderState
from cell.errors import CellError
from cell.samples import Sample
from cell.testing.bench import Bench, Rig, known
from cell.testing.device import DeviceContract


class Belt(Protocol):
    """The belt that the encoder turns with; it stops and runs as a case says."""

    def travel_at(self, t: float) -> float:
        """m since some moment."""
        ...

    def run(self, t: float, speed: float, accel: float) -> None:
        """From ``t`` on at ``speed``, m/s, reached at ``accel``, m/s^2."""
        ...


@dataclass
class EncoderRig(Rig[Encoder]):
    """``belt`` is the one that the encoder turns with, at 0.1 mm a count, for the truth."""

    belt: Belt | None = field(default=None, kw_only=True)

    @property
    def driven(self) -> Belt:
        return known(self.belt, "belt")

    def samples(self) -> list[Sample[EncoderState]]:
        """All samples of this epoch."""
        return self.device.counts.between(0.0, self.clock.now() + 1.0)

    async def fresh(self) -> Sample[EncoderState]:
        """A sample that was taken after the call."""
        await self.device.wait_fresh(10.0)
        return self.device.counts.latest(10.0)


M_PER_COUNT, RANGE = 1e-4, 65536  # of the belt's encoder, where the truth is known


async def undisturbed(rig: EncoderRig) -> list[Sample[EncoderState]]:
    """Samples of a time in which the sender, which is in this process, did not stand still."""
    for _ in range(20):
        begin = rig.clock.now()
        await rig.clock.sleep(0.4)
        samples = rig.device.counts.between(begin, rig.clock.now())
        if np.max(np.diff([s.t for s in samples]), initial=0.0) < 4.0 * rig.device.period_s:
            return samples
    raise AssertionError("no 0.4 s without a pause of this process")


class EncoderContract(DeviceContract[EncoderRig]):
    """Counts follow the belt, go on where the device wraps, and each loss has its own name."""

    def test_samples_come_in_order_and_counts_differ_from_raw_by_whole_ranges(
        self, subject: Bench[EncoderRig]
    ) -> None:
        async def scene(rig: EncoderRig) -> None:
            for _ in range(20):
                await rig.fresh()
            samples, modulus = rig.samples(), rig.device.modulus
            assert len(samples) >= 20
            assert rig.device.period_s > 0.0
            assert all(a.t <= b.t and a.seq < b.seq for a, b in pairwise(samples))
            assert all(s.dt >= 0.0 and s.t <= rig.clock.now() for s in samples)
            assert all(0 <= s.value.raw < modulus for s in samples)
            first = samples[0].value
            assert first.count == 0
            assert all((s.value.count - (s.value.raw - first.raw)) % modulus == 0 for s in samples)

        subject(scene)

    def test_range_and_period_are_those_of_the_encoder(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("truth")

        async def scene(rig: EncoderRig) -> None:
            assert rig.device.modulus == RANGE
            assert rig.device.period_s == 0.005

        subject(scene)

    def test_counts_follow_the_belt_within_their_stated_time(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("truth")

        async def scene(rig: EncoderRig) -> None:
            samples = await undisturbed(rig)
            assert len(samples) > 40
            assert all(a.t <= b.t and a.seq < b.seq for a, b in pairwise(samples))
            assert rig.samples()[0].value.count == 0
            counted = np.array([s.value.count for s in samples]) * M_PER_COUNT
            true = np.array([rig.driven.travel_at(s.t) for s in samples])
            off = (counted - true) - np.median(counted - true)
            fastest = 0.2
            allowed = M_PER_COUNT + fastest * (np.array([s.dt for s in samples]) + 0.003)
            assert np.mean(np.abs(off) <= allowed) > 0.9

        subject(scene)

    def test_raw_is_the_encoders_own_position_and_count_goes_on_where_it_wraps(
        self,
        subject: Bench[EncoderRig],
    ) -> None:
        subject.needs("truth", "belt-stop", "wrap")

        async def scene(rig: EncoderRig) -> None:
            await rig.inject("belt-stop", accel=10.0)
            await rig.clock.sleep(0.15)
            await rig.device.close()
            await rig.inject("wrap", before=50)
            await rig.reopen()
            rig.driven.run(rig.clock.now(), 0.15, 10.0)
            await rig.clock.sleep(0.3)
            samples = rig.samples()
            first, last = samples[0].value, samples[-1].value
            assert first.raw == RANGE - 50
            assert 0 <= last.raw < 2000, "it has wrapped"
            assert all((s.value.count - (s.value.raw - first.raw)) % RANGE == 0 for s in samples)
            assert 100 < last.count == last.raw + 50

        subject(scene)

    def test_a_belt_that_stands_goes_on_giving_samples_and_one_that_turns_back_counts_down(
        self,
        subject: Bench[EncoderRig],
    ) -> None:
        subject.needs("truth", "belt-stop")

        async def scene(rig: EncoderRig) -> None:
            await rig.inject("belt-stop", accel=10.0)
            await rig.clock.sleep(0.15)
            stood = (await rig.fresh()).value.count
            await rig.clock.sleep(0.1)
            assert (await rig.fresh()).value.count == stood
            rig.driven.run(rig.clock.now(), -0.15, 10.0)
            await rig.clock.sleep(0.2)
            assert (await rig.fresh()).value.count < stood - 100

        subject(scene)

    def test_slip_is_seen_as_travel(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("belt-stop", "slip")

        async def scene(rig: EncoderRig) -> None:
            await rig.inject("belt-stop", accel=10.0)
            await rig.clock.sleep(0.15)
            before = (await rig.fresh()).value.count
            await rig.inject("slip", m=0.005, s=0.02)
            await rig.clock.sleep(0.1)
            assert (await rig.fresh()).value.count - before == pytest.approx(50, abs=1)

        subject(scene)

    def test_lost_frames_are_counted_and_are_no_loss_of_the_device(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("gap")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            before = rig.device.counts.gaps
            await rig.inject("gap", count=7)
            await rig.clock.sleep(0.25)
            await rig.fresh()
            assert rig.device.counts.gaps - before >= 6
            assert rig.device.counts.epoch == 1

        subject(scene)

    def test_silence_makes_counts_stale_and_then_loses_the_device(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("silence")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            await rig.inject("silence")
            await rig.clock.sleep(0.1)
            with pytest.raises(CellError) as stale:
                rig.device.counts.latest(0.05)
            assert stale.value.name == "STALE_DATA"
            assert (await rig.loss(10.0)).name == "DEVICE_LOST"
            with pytest.raises(CellError):
                await rig.device.identify()
            await rig.inject("clear")
            await rig.reopen()

        subject(scene)

    def test_an_encoder_that_is_unplugged_is_lost_cannot_be_opened_and_comes_back_in_a_new_epoch(
        self,
        subject: Bench[EncoderRig],
    ) -> None:
        subject.needs("unplug")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            epoch = rig.device.counts.epoch
            await rig.inject("unplug")
            assert (await rig.loss(10.0)).name == "DEVICE_LOST"
            await rig.device.close()
            with pytest.raises(CellError) as caught:
                await rig.device.open()
            assert caught.value.name == "DEVICE_UNREACHABLE"
            await rig.inject("clear")
            await rig.reopen()
            assert rig.device.counts.epoch > epoch
            assert rig.samples()[0].value.count == 0

        subject(scene)

    def test_a_dropped_link_is_told_at_once(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("drop")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            told = rig.clock.now()
            await rig.inject("drop")
            assert (await rig.loss(10.0)).name == "DEVICE_LOST"
            assert rig.clock.now() - told < 0.8, "earlier than silence tells"
            await rig.reopen()

        subject(scene)

    def test_a_bus_that_goes_off_is_told_by_name(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("bus-off")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            await rig.inject("bus-off")
            assert (await rig.loss(10.0)).name == "CAN_BUS_OFF"
            await rig.inject("clear")
            await rig.reopen()

        subject(scene)

    def test_a_node_that_another_master_stops_is_lost_and_started_again(
        self, subject: Bench[EncoderRig]
    ) -> None:
        subject.needs("node-stop")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            await rig.inject("node-stop")
            assert (await rig.loss(10.0)).name == "ENCODER_NOT_OPERATIONAL"
            await rig.reopen()

        subject(scene)

    def test_a_node_that_restarts_is_configured_again_and_begins_a_new_epoch(
        self,
        subject: Bench[EncoderRig],
    ) -> None:
        subject.needs("reboot")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            epoch = rig.device.counts.epoch
            await rig.inject("reboot", boot_s=0.05)
            async with asyncio.timeout(10.0):
                while rig.device.counts.epoch == epoch or rig.device.counts.last() is None:
                    await rig.clock.sleep(0.01)
            assert rig.device.counts.epoch == epoch + 1
            assert rig.samples()[0].value.count == 0
            await rig.fresh()
            await rig.device.identify()

        subject(scene)

    def test_another_node_in_the_place_of_ours_ends_the_link(self, subject: Bench[EncoderRig]) -> None:
        subject.needs("reboot")

        async def scene(rig: EncoderRig) -> None:
            await rig.fresh()
            await rig.inject("reboot", boot_s=0.05, serial="999966077")
            assert (await rig.loss(10.0)).name == "DEVICE_LOST"
            await rig.reopen()
            assert (await rig.device.identify()).serial == "999966077"

        subject(scene)
