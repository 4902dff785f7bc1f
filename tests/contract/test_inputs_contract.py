"""What every group of digital inputs promises, on every face."""

import asyncio
from collections.abc import Callable, Coroutine
from itertools import pairwise
from typing import Any

import pytest
from inputs_faces import InputsRig, inputs_faces
from wire_faces import Face

from cell.devices import DigitalInputs
from cell.errors import CellError
from cell.inputs import edges
from cell.samples import Quality

Scene = Callable[[InputsRig], Coroutine[Any, Any, Any]]
XS, YS = 0, 1


@pytest.fixture(params=inputs_faces())
def face(request: pytest.FixtureRequest) -> Face[InputsRig]:
    return request.param


@pytest.fixture
def subject(face: Face[InputsRig]) -> Callable[[Scene], Any]:
    """Runs a scene with open inputs on this face."""

    def play(scene: Scene) -> Any:
        async def whole() -> Any:
            async with face.rig(None) as rig:
                return await scene(rig)

        return face.run(whole())

    return play


async def loss_of(device: DigitalInputs) -> CellError:
    """What ended the link; it must come within a second."""
    async with asyncio.timeout(1.0):
        found = await device.wait_lost()
    assert isinstance(found, CellError)
    return found


async def reopen(rig: InputsRig) -> None:
    """As the supervisor does: until it opens."""
    async with asyncio.timeout(5.0):
        while True:
            await rig.device.close()
            try:
                await rig.device.open()
                return
            except CellError as exc:
                if exc.name not in ("DEVICE_UNREACHABLE", "DEVICE_LOST"):
                    raise
            await rig.clock.sleep(0.05)


def test_inputs_have_the_names_of_the_config_in_its_order(subject: Callable[[Scene], Any]) -> None:
    async def scene(rig: InputsRig) -> None:
        assert rig.device.names == ("xs", "ys")
        await rig.switch("ys", True)
        state = (await rig.fresh()).value
        assert state.levels == (False, True)
        assert state.changes == (0, 1)

    subject(scene)


def test_a_twin_says_that_it_is_one_and_keeps_its_identity(subject: Callable[[Scene], Any]) -> None:
    async def scene(rig: InputsRig) -> None:
        found = await rig.device.identify()
        assert (found.model, found.serial) == ("ioLogik-E1210", "99993300001")
        assert found.is_twin
        assert await rig.device.identify() == found

    subject(scene)


def test_polls_come_in_order_on_our_clock_with_a_half_width_below_their_period(
    subject: Callable[[Scene], Any],
) -> None:
    async def scene(rig: InputsRig) -> None:
        begun = rig.clock.now()
        await rig.clock.sleep(30 * rig.period_s)
        polls = rig.device.inputs.between(begun, rig.clock.now())
        assert len(polls) >= 15
        assert all(a.t < b.t and a.seq < b.seq for a, b in pairwise(polls))
        halves = sorted(poll.dt for poll in polls)
        assert halves[0] > 0.0
        assert halves[len(halves) // 2] < rig.period_s
        assert all(poll.quality is Quality.GOOD for poll in polls)
        assert rig.clock.now() - polls[-1].t < 0.2

    subject(scene)


def test_an_edge_lies_within_its_bracket_and_changes_follow_the_level(
    subject: Callable[[Scene], Any],
) -> None:
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


def test_a_pulse_between_two_polls_is_two_changes(subject: Callable[[Scene], Any]) -> None:
    async def scene(rig: InputsRig) -> None:
        await rig.fresh()
        for n in range(1, 6):
            await rig.pulse("ys")
            state = (await rig.fresh()).value
            assert state.levels == (False, False)
            assert state.changes == (0, 2 * n)
        assert len(edges(rig.polls(), YS)) == 10

    subject(scene)


def test_counters_go_on_through_their_wrap(subject: Callable[[Scene], Any]) -> None:
    async def scene(rig: InputsRig) -> None:
        await rig.device.close()
        await rig.inject("wrap", before=3)
        await reopen(rig)
        for _ in range(6):
            await rig.pulse("xs")
        assert (await rig.fresh()).value.changes == (12, 0)
        assert rig.device.inputs.epoch == 2

    subject(scene)


def test_polls_that_do_not_come_are_counted_as_gaps(subject: Callable[[Scene], Any]) -> None:
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


def test_silence_makes_readings_stale_and_then_loses_the_device(subject: Callable[[Scene], Any]) -> None:
    async def scene(rig: InputsRig) -> None:
        await rig.fresh()
        await rig.inject("silence")
        await rig.clock.sleep(0.06)
        with pytest.raises(CellError) as stale:
            rig.device.inputs.latest(0.05)
        assert stale.value.name == "STALE_DATA"
        assert (await loss_of(rig.device)).name == "DEVICE_LOST"
        with pytest.raises(CellError) as caught:
            await rig.device.wait_fresh(0.1)
        assert caught.value.name == "DEVICE_LOST"
        with pytest.raises(CellError):
            await rig.device.identify()
        await rig.inject("clear")
        await reopen(rig)
        await rig.fresh()

    subject(scene)


def test_a_dropped_link_is_told_at_once_and_the_next_opening_is_a_new_epoch(
    subject: Callable[[Scene], Any], face: Face[InputsRig]
) -> None:
    if "drop" in face.lacks:
        pytest.skip(f"the {face.name} face has no drop")

    async def scene(rig: InputsRig) -> None:
        await rig.switch("xs", True)
        await rig.pulse("ys")
        await rig.fresh()
        epoch = rig.device.inputs.epoch
        waiting = asyncio.create_task(loss_of(rig.device))
        await rig.clock.sleep(0.01)
        told = rig.clock.now()
        await rig.inject("drop")
        assert (await waiting).name == "DEVICE_LOST"
        assert rig.clock.now() - told < 0.2
        await reopen(rig)
        assert rig.device.inputs.epoch == epoch + 1
        first = await rig.fresh()
        assert first.value.levels == (True, False)
        assert first.value.changes == (0, 0)
        assert all(poll.t > told for poll in rig.polls())

    subject(scene)


def test_a_module_that_refuses_is_unreachable_and_comes_back(
    subject: Callable[[Scene], Any], face: Face[InputsRig]
) -> None:
    if "refuse" in face.lacks:
        pytest.skip(f"the {face.name} face has no refuse")

    async def scene(rig: InputsRig) -> None:
        await rig.inject("refuse")
        await loss_of(rig.device)
        await rig.device.close()
        with pytest.raises(CellError) as caught:
            await rig.device.open()
        assert caught.value.name == "DEVICE_UNREACHABLE"
        await rig.inject("clear")
        await reopen(rig)
        await rig.fresh()

    subject(scene)


def test_a_module_that_restarts_is_lost_and_begins_to_count_anew(subject: Callable[[Scene], Any]) -> None:
    async def scene(rig: InputsRig) -> None:
        for _ in range(3):
            await rig.pulse("xs")
        assert (await rig.fresh()).value.changes == (6, 0)
        await rig.inject("reboot", boot_s=0.3, serial="99993300077")
        assert (await loss_of(rig.device)).name in ("DEVICE_LOST", "MODULE_REBOOTED")
        await reopen(rig)
        assert (await rig.device.identify()).serial == "99993300077"
        assert (await rig.fresh()).value.changes == (0, 0)
        await rig.pulse("xs")
        assert (await rig.fresh()).value.changes == (2, 0)

    subject(scene)


def test_a_closed_device_says_so_and_closing_again_is_harmless(subject: Callable[[Scene], Any]) -> None:
    async def scene(rig: InputsRig) -> None:
        await rig.device.close()
        await rig.device.close()
        assert (await loss_of(rig.device)).name == "DEVICE_LOST"
        with pytest.raises(CellError):
            await rig.device.identify()
        assert isinstance(rig.device.health(), dict)

    subject(scene)
