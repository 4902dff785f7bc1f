"""What every group of digital inputs promises, on every face."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from itertools import pairwise

import pytest

from cell.devices import DigitalInputs, InputsState
from cell.errors import CellError
from cell.inputs import edges
from cell.samples import Quality, Sample
from cell.testing.bench import Bench, Rig
from cell.testing.device import DeviceContract

XS, YS = 0, 1


async def no_loss() -> None:
    """The ``lose_polls`` of a bench that cannot do it."""
    raise ValueError("this bench cannot lose polls; say gap in its lacks")


@dataclass
class InputsRig(Rig[DigitalInputs]):
    """Inputs ``xs`` and ``ys``, both off, read every ``period_s``.

    ``inject("stuck", input=NAME, level="on")`` sets the contact of an input. ``lose_polls`` makes the next
    few polls fail to come, without ending the link.
    """

    lose_polls: Callable[[], Awaitable[None]] = field(default=no_loss, kw_only=True)
    period_s: float = field(default=0.02, kw_only=True)

    async def switch(self, name: str, on: bool) -> None:
        """Set the contact of an input that is not inverted."""
        await self.inject("stuck", input=name, level="on" if on else "off")

    async def pulse(self, name: str) -> None:
        """On and off, so fast that no poll is likely to see it."""
        await self.switch(name, True)
        await self.clock.sleep(0.0003)
        await self.switch(name, False)

    async def fresh(self) -> Sample[InputsState]:
        """A poll that was made after the call."""
        await self.device.wait_fresh(2.0)
        return self.device.inputs.latest(1.0)

    def polls(self) -> list[Sample[InputsState]]:
        """All polls of this epoch."""
        return self.device.inputs.between(0.0, self.clock.now() + 1.0)


class InputsContract(DeviceContract[InputsRig]):
    """Polls are stamped with their bracket, and no edge or pulse is missed."""

    def test_inputs_have_the_names_of_the_config_in_its_order(self, subject: Bench[InputsRig]) -> None:
        subject.needs("stuck")

        async def scene(rig: InputsRig) -> None:
            assert rig.device.names == ("xs", "ys")
            await rig.switch("ys", True)
            state = (await rig.fresh()).value
            assert state.levels == (False, True)
            assert state.changes == (0, 1)

        subject(scene)

    def test_polls_come_in_order_on_our_clock_with_a_half_width_below_their_period(
        self,
        subject: Bench[InputsRig],
    ) -> None:
        async def scene(rig: InputsRig) -> None:
            begun = rig.clock.now()
            for _ in range(20):
                await rig.fresh()
            polls = rig.device.inputs.between(begun, rig.clock.now())
            assert len(polls) >= 20
            gaps = sorted(b.t - a.t for a, b in pairwise(polls))
            assert gaps[len(gaps) // 2] < 2.0 * rig.period_s
            assert all(a.t < b.t and a.seq < b.seq for a, b in pairwise(polls))
            halves = sorted(poll.dt for poll in polls)
            assert halves[0] > 0.0
            assert halves[len(halves) // 2] < rig.period_s
            assert all(poll.quality is Quality.GOOD for poll in polls)
            # A poll of a machine that pauses takes as long as the pause, and says so by its half-width.
            now = rig.clock.now()
            newest = await rig.fresh()
            assert newest.t + newest.dt >= now
            assert newest.t - newest.dt <= rig.clock.now()

        subject(scene)

    def test_an_edge_lies_within_its_bracket_and_changes_follow_the_level(
        self,
        subject: Bench[InputsRig],
    ) -> None:
        subject.needs("stuck")

        async def scene(rig: InputsRig) -> None:
            await rig.fresh()
            made: list[float] = []
            for on in (True, False, True):
                made.append(rig.clock.now())
                await rig.switch("xs", on)
                await rig.clock.sleep(3.3 * rig.period_s)
            await rig.fresh()
            polls = rig.polls()
            found = edges(polls, XS)
            assert [edge.rising for edge in found] == [True, False, True]
            for edge, t in zip(found, made, strict=True):
                assert abs(edge.t - t) <= edge.dt + 0.001  # between reading the clock and switching
            assert not edges(polls, YS)
            for a, b in pairwise(polls):
                for k in (XS, YS):
                    assert b.value.changes[k] >= a.value.changes[k]
                    moved = a.value.levels[k] != b.value.levels[k]
                    assert (b.value.changes[k] - a.value.changes[k]) % 2 == moved

        subject(scene)

    def test_a_pulse_between_two_polls_is_two_changes(self, subject: Bench[InputsRig]) -> None:
        subject.needs("stuck")

        async def scene(rig: InputsRig) -> None:
            await rig.fresh()
            for n in range(1, 6):
                await rig.pulse("ys")
                state = (await rig.fresh()).value
                assert state.levels == (False, False)
                assert state.changes == (0, 2 * n)
            assert len(edges(rig.polls(), YS)) == 10

        subject(scene)

    def test_counters_go_on_through_their_wrap(self, subject: Bench[InputsRig]) -> None:
        subject.needs("stuck", "wrap")

        async def scene(rig: InputsRig) -> None:
            await rig.device.close()
            await rig.inject("wrap", before=3)
            await rig.reopen()
            for _ in range(6):
                await rig.pulse("xs")
            assert (await rig.fresh()).value.changes == (12, 0)
            assert rig.device.inputs.epoch == 2

        subject(scene)

    def test_polls_that_do_not_come_are_counted_as_gaps(self, subject: Bench[InputsRig]) -> None:
        subject.needs("gap")

        async def scene(rig: InputsRig) -> None:
            await rig.fresh()
            before = rig.device.inputs.gaps
            await rig.lose_polls()
            for _ in range(8):
                await rig.fresh()
            assert rig.device.inputs.gaps >= before + 4
            assert rig.device.inputs.epoch == 1, "a gap is no loss"
            polls = rig.polls()
            assert polls[-1].seq - polls[0].seq >= len(polls) + 3

        subject(scene)

    def test_silence_makes_readings_stale_and_then_loses_the_device(self, subject: Bench[InputsRig]) -> None:
        subject.needs("silence")

        async def scene(rig: InputsRig) -> None:
            await rig.fresh()
            await rig.inject("silence")
            await rig.clock.sleep(0.06)
            with pytest.raises(CellError) as stale:
                rig.device.inputs.latest(0.05)
            assert stale.value.name == "STALE_DATA"
            assert (await rig.loss(1.0)).name == "DEVICE_LOST"
            with pytest.raises(CellError) as caught:
                await rig.device.wait_fresh(0.1)
            assert caught.value.name == "DEVICE_LOST"
            with pytest.raises(CellError):
                await rig.device.identify()
            await rig.inject("clear")
            await rig.reopen()
            await rig.fresh()

        subject(scene)

    def test_a_dropped_link_is_told_at_once_and_the_next_opening_is_a_new_epoch(
        self, subject: Bench[InputsRig]
    ) -> None:
        subject.needs("stuck", "drop")

        async def scene(rig: InputsRig) -> None:
            await rig.switch("xs", True)
            await rig.pulse("ys")
            await rig.fresh()
            epoch = rig.device.inputs.epoch
            waiting = asyncio.create_task(rig.loss(1.0))
            await rig.clock.sleep(0.01)
            told = rig.clock.now()
            await rig.inject("drop")
            assert (await waiting).name == "DEVICE_LOST"
            assert rig.clock.now() - told < 0.2
            await rig.reopen()
            assert rig.device.inputs.epoch == epoch + 1
            first = await rig.fresh()
            assert first.value.levels == (True, False)
            assert first.value.changes == (0, 0)
            assert all(poll.t > told for poll in rig.polls())

        subject(scene)

    def test_a_module_that_refuses_is_unreachable_and_comes_back(self, subject: Bench[InputsRig]) -> None:
        subject.needs("refuse")

        async def scene(rig: InputsRig) -> None:
            await rig.inject("refuse")
            await rig.loss(1.0)
            await rig.device.close()
            with pytest.raises(CellError) as caught:
                await rig.device.open()
            assert caught.value.name == "DEVICE_UNREACHABLE"
            await rig.inject("clear")
            await rig.reopen()
            await rig.fresh()

        subject(scene)

    def test_a_module_that_restarts_is_lost_and_begins_to_count_anew(self, subject: Bench[InputsRig]) -> None:
        subject.needs("stuck", "reboot")

        async def scene(rig: InputsRig) -> None:
            for _ in range(3):
                await rig.pulse("xs")
            assert (await rig.fresh()).value.changes == (6, 0)
            await rig.inject("reboot", boot_s=0.3, serial="99993300077")
            assert (await rig.loss(1.0)).name in ("DEVICE_LOST", "MODULE_REBOOTED")
            await rig.reopen()
            assert (await rig.device.identify()).serial == "99993300077"
            assert (await rig.fresh()).value.changes == (0, 0)
            await rig.pulse("xs")
            assert (await rig.fresh()).value.changes == (2, 0)

        subject(scene)
