"""The twin's station without wires: its lines, its procedures and their return codes, on virtual time."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from geocompy.communication import crc16_bytewise

from fakes.faults.vocabulary import Link, LinkFaults
from fakes.geocom.codes import OVERRUN, WRONG_CHECKSUM, WRONG_FORMAT
from fakes.geocom.conversation import Conversation, LineFaults
from fakes.geocom.instrument import EVERY, Instrument
from fakes.geocom.text import Receiver, RefusedLine, parse, reply
from fakes.object import VirtualClock, run_virtual
from fakes.world.scenario import Scenario
from fakes.world.tracker.tracker import polar
from fakes.world.tracker.visibility import BROKEN
from fakes.world.world import World

Scene = Callable[[Instrument], Coroutine[Any, Any, Any]]


def play(scene: Scene) -> Any:
    """Run ``scene`` with a station on virtual time."""

    async def whole() -> Any:
        clock = VirtualClock()
        world = World.from_scenario(Scenario.load("tracker:ideal"), clock.now())
        assert world.tracker is not None
        return await scene(Instrument(world.tracker, clock.now))

    return run_virtual(whole())


async def call(subject: Instrument, rpc: int, *parameters: float) -> tuple[int, tuple[Any, ...]]:
    return await subject.call(rpc, tuple(str(value) for value in parameters))


async def lock(subject: Instrument, name: str = "smr1") -> None:
    """Aim at a reflector from nearby and follow it."""
    hz, v = polar(subject.tracker.visibility.local(name, subject.now()))
    for rpc, parameters in (
        (9027, (hz + 0.003, v - 0.003, 0, 0, 0)),
        (9018, (1,)),
        (9037, (0.03, 0.03, 0)),
        (9020, (1,)),
        (9013, ()),
    ):
        assert (await call(subject, rpc, *parameters))[0] == 0


# -- lines


def test_lines_are_cut_at_cr_and_lf_clears_what_came_before() -> None:
    subject = Receiver()
    assert subject.feed(b"%R1Q,0,1:\r\n") == [b"%R1Q,0,1:"]
    assert subject.feed(b"half a li\n%R1Q,") == []
    assert subject.feed(b"0,2:\r\n%R1Q,0,3:\r") == [b"%R1Q,0,2:", b"%R1Q,0,3:"]
    (long,) = subject.feed(b"x" * 5000 + b"\r")
    with pytest.raises(RefusedLine) as caught:
        parse(long)
    assert caught.value.code == OVERRUN


def test_a_request_is_read_with_and_without_transaction_check_sum_and_parameters() -> None:
    assert parse(b"%R1Q,2108,7:5000,1").parameters == ("5000", "1")
    assert parse(b"%R1Q,5003,7:").parameters == ()
    assert parse(b"%R1Q,5003:").transaction == 0
    text = "%R1Q,2024,12:0.0344"
    checked = text.replace(",12:", f",12,{crc16_bytewise(text)}:").encode()
    assert parse(checked).checked
    with pytest.raises(RefusedLine) as caught:
        parse(checked.replace(b"0.0344", b"0.0345"))
    assert (caught.value.code, caught.value.transaction) == (WRONG_CHECKSUM, 12)


@pytest.mark.parametrize("line", [b"", b"hello", b"%R1P,0,1:0", b"%R1Q,x,1:", b"%R1Q,1\xff,1:", b"%R1Q,0,1"])
def test_what_is_no_request_has_the_wrong_format(line: bytes) -> None:
    with pytest.raises(RefusedLine) as caught:
        parse(line)
    assert caught.value.code == WRONG_FORMAT


def test_an_answer_writes_texts_booleans_and_as_many_decimals_as_were_asked_for() -> None:
    assert reply(3, 0, (1.5, True, 7, "name"), 4, False) == b'%R1P,0,3:0,1.5000,1,7,"name"\r\n'
    assert reply(3, 1285, (), 15, False) == b"%R1P,0,3:1285\r\n"
    checked = reply(3, 0, (2.0,), 1, True).decode().strip()
    crc = checked.split(":")[0].split(",")[3]
    assert int(crc) == crc16_bytewise(checked.replace(f",{crc}:", ":"))


def test_whoever_sends_nonsense_is_answered_by_the_line_and_an_abort_by_a_question_mark() -> None:
    class Wire(asyncio.Transport):
        def __init__(self) -> None:
            super().__init__()
            self.sent = b""

        def write(self, data: Any) -> None:
            self.sent += bytes(data)

        def is_closing(self) -> bool:
            return False

        def get_write_buffer_size(self) -> int:
            return 0

    async def scene(subject: Instrument) -> bytes:
        wire, faults = Wire(), LineFaults()
        conversation = Conversation(subject, Link(wire, LinkFaults()), faults)
        conversation.received(
            b"nonsense\r\n%R1Q,0,1:\r\n%R1Q,4711,2:\r\nc\r\n%R1Q,107,3:3\r\n%R1Q,2023,4:\r\n"
        )
        await asyncio.sleep(1.0)
        faults.lose = 1
        conversation.received(b"%R1Q,0,5:\r\n%R1Q,0,6:\r\n")
        await asyncio.sleep(1.0)
        subject.forced[EVERY] = 3077
        conversation.received(b"%R1Q,0,7:\r\n")
        await asyncio.sleep(1.0)
        subject.forced.clear()
        conversation.received(b"%R1Q,2024,8:much\r\n")
        await asyncio.sleep(1.0)
        conversation.close()
        return wire.sent

    assert play(scene).decode().splitlines() == [
        "?",
        "%R1P,3078,0:0",
        "%R1P,0,1:0",
        "%R1P,0,2:5",
        "%R1P,0,3:0",
        "%R1P,0,4:0,0.000",
        "%R1P,0,6:0",
        "%R1P,3077,7:0",
        "%R1P,3080,8:0",
    ]


# -- procedures


def test_settings_are_read_back_and_refused_beyond_their_range() -> None:
    async def scene(subject: Instrument) -> None:
        for write, read, value in (
            (107, 108, (9,)),
            (2010, 2009, (100.0, 200.0, 5.0, 1.5)),
            (2012, 2011, (0.1,)),
            (2020, 2021, (3,)),
            (2024, 2023, (-0.0169,)),
            (2028, 2029, (658e-9, 990.0, 25.0, 24.0)),
            (9018, 9019, (1,)),
            (9020, 9021, (1,)),
            (17008, 17009, (7,)),
        ):
            assert await call(subject, write, *value) == (0, ())
            assert await call(subject, read) == (0, value)
        assert await call(subject, 2023) == (0, (0.03,)), "the constant comes with the type of the prism"
        for rpc, wrong in (
            (107, (16,)),
            (2024, (1.0,)),
            (17008, (40,)),
            (2008, (7, 1)),
            (9027, (0, 4, 0, 0, 0)),
        ):
            assert (await call(subject, rpc, *wrong))[0] == 2
        assert (await subject.call(2024, ("one",)))[0] == 3080
        assert (await call(subject, 2024))[0] == 3080
        assert (await call(subject, 2024, float("nan")))[0] == 2
        assert (await call(subject, 17023, 0))[0] == 5

    play(scene)


def test_the_point_of_every_procedure_is_the_same_and_true() -> None:
    async def scene(subject: Instrument) -> None:
        await lock(subject)
        true = subject.tracker.visibility.local("smr1", subject.now())
        assert (await call(subject, 2010, 10.0, 20.0, 30.0, 0.5))[0] == 0
        assert (await call(subject, 2012, 0.2))[0] == 0
        assert (await call(subject, 2008, 1, 1))[0] == 0
        code, (e, n, h, stamp, *again) = await call(subject, 2082, 5000, 1)
        assert code == 0
        assert again == [e, n, h, stamp]
        assert np.array([e, n, h]) - [10.0, 20.0, 30.3] == pytest.approx(true, abs=2e-4)
        _, simple = await call(subject, 2116, 5000, 1)
        assert simple == (e, n, h)
        _, (hz, v, slope) = await call(subject, 2108, 5000, 1)
        polar_point = slope * np.array([np.sin(hz) * np.sin(v), np.cos(hz) * np.sin(v), np.cos(v)])
        assert polar_point == pytest.approx(np.array([e, n, h]) - [10.0, 20.0, 30.3], abs=1e-12)
        _, full = await call(subject, 2167, 5000, 1)
        assert (full[0], full[1], full[6], full[7]) == (hz, v, slope, stamp)
        _, angles = await call(subject, 2107, 1)
        assert angles == pytest.approx(polar(true), abs=1e-9)
        code, (*_, distance, mode) = await call(subject, 17017, 2)
        assert (code, mode) == (0, 2)
        assert distance == pytest.approx(np.linalg.norm(true), abs=2e-4)
        code, (*_, distance) = await call(subject, 2117)
        assert code == 0
        assert distance == pytest.approx(np.linalg.norm(true), abs=2e-4)

    play(scene)


def test_without_noise_the_point_is_exact_to_the_digits_that_are_sent() -> None:
    async def scene(subject: Instrument) -> None:
        quiet = {"sigma0_m": 0.0, "sigma_per_m": 0.0}
        subject.tracker.truth = subject.tracker.truth.model_copy(update=quiet)
        await lock(subject)
        true = subject.tracker.visibility.local("smr1", subject.now())
        await call(subject, 2008, 1, 1)
        _, coordinate = await call(subject, 2116, 1000, 1)
        assert coordinate == pytest.approx(true, abs=1e-12)
        _, (hz, v, slope) = await call(subject, 2108, 1000, 1)
        assert (hz, v) == pytest.approx(polar(true), abs=1e-12)
        assert slope == pytest.approx(np.linalg.norm(true), abs=1e-12)

    play(scene)


def test_a_distance_takes_its_time_and_is_not_there_before() -> None:
    async def scene(subject: Instrument) -> None:
        await lock(subject)
        assert (await call(subject, 2108, 1000, 1))[0] == 1285, "none was asked for"
        await call(subject, 2008, 1, 1)
        code, (hz, v, slope) = await call(subject, 2108, 10, 1)
        assert (code, slope) == (1285, 0.0)
        assert hz or v
        begun = subject.now()
        assert (await call(subject, 2108, 1000, 1))[0] == 0
        assert subject.now() - begun < subject.tracker.truth.measure_s
        stamps = {(await call(subject, 2167, 1000, 1))[1][7] for _ in range(5)}
        assert len(stamps) == 1, "a single distance stays the same"
        await call(subject, 2008, 3, 1)
        assert (await call(subject, 2108, 0, 1))[0] == 1285

    play(scene)


def test_tracking_gives_new_distances_at_its_rate() -> None:
    async def scene(subject: Instrument) -> None:
        await lock(subject)
        await call(subject, 2008, 8, 1)
        await asyncio.sleep(0.1)
        begun, stamps = subject.now(), set()
        while subject.now() < begun + 1.0:
            stamps.add((await call(subject, 2167, 0, 1))[1][7])
        assert len(stamps) in range(49, 53)
        await call(subject, 2008, 0, 1)
        kept = {(await call(subject, 2167, 0, 1))[1][7] for _ in range(10)}
        assert len(kept) == 1

    play(scene)


def test_noise_of_many_tracked_distances_is_what_the_scenario_says() -> None:
    async def scene(subject: Instrument) -> None:
        await lock(subject, "m1")
        true = subject.tracker.visibility.local("m1", subject.now())
        await call(subject, 2008, 8, 1)
        points: dict[int, list[float]] = {}
        while len(points) < 2000:
            code, (e, n, h, stamp, *_) = await call(subject, 2082, 1000, 1)
            assert code == 0
            points[stamp] = [e, n, h]
            await asyncio.sleep(0.015)
        errors = np.array(list(points.values())) - true
        sigma = 15e-6 + 6e-6 * np.linalg.norm(true)
        # The standard deviation of 2000 readings is known within 1.6 %; five times that is allowed.
        assert errors.std(axis=0) == pytest.approx(np.full(3, sigma), rel=0.08)
        assert np.abs(errors.mean(axis=0)).max() < 5 * sigma / np.sqrt(2000)

    play(scene)


def test_without_a_target_there_is_no_distance_and_no_lock() -> None:
    async def scene(subject: Instrument) -> None:
        assert (await call(subject, 9037, 0.03, 0.03, 0))[0] == 8714, "target recognition is off"
        assert (await call(subject, 9013))[0] == 8714
        await call(subject, 9018, 1)
        assert (await call(subject, 9037, 0.03, 0.03, 0))[0] == 8710
        await call(subject, 9020, 1)
        assert (await call(subject, 9013))[0] == 8725
        assert await call(subject, 6021) == (0, (0,))
        await call(subject, 2008, 1, 1)
        assert (await call(subject, 2108, 1000, 1))[0] == 1292
        assert (await call(subject, 17017, 2))[0] == 8710

    play(scene)


def test_a_broken_beam_ends_the_lock_until_the_next_search() -> None:
    async def scene(subject: Instrument) -> None:
        await lock(subject)
        assert await call(subject, 6021) == (0, (1,))
        subject.tracker.visibility.hinder(BROKEN, subject.now())
        subject.tracker.visibility.free(subject.now() + 0.02)
        await asyncio.sleep(0.1)
        assert await call(subject, 6021) == (0, (0,))
        await call(subject, 2008, 8, 1)
        code, (_, _, slope) = await call(subject, 2108, 1000, 1)
        assert (code, slope) == (1292, 0.0)
        assert (await call(subject, 9037, 0.03, 0.03, 0))[0] == 0
        assert (await call(subject, 9013))[0] == 0
        await call(subject, 2008, 8, 1)
        assert (await call(subject, 2108, 1000, 1))[0] == 0

    play(scene)


def test_two_reflectors_side_by_side_are_too_many() -> None:
    async def scene(subject: Instrument) -> None:
        subject.tracker.truth = subject.tracker.truth.model_copy(update={"separable_rad": 0.3})
        hz, v = polar(subject.tracker.visibility.local("m1", subject.now()))
        await call(subject, 9027, hz, v, 0, 0, 0)
        await call(subject, 9018, 1)
        assert (await call(subject, 9037, 0.5, 0.5, 0))[0] == 8711

    play(scene)


def test_turning_takes_time_and_can_be_aborted() -> None:
    async def scene(subject: Instrument) -> None:
        begun = subject.now()
        assert (await call(subject, 9027, np.pi, np.pi / 2, 0, 0, 0))[0] == 0
        assert subject.now() - begun == pytest.approx(np.pi / subject.tracker.truth.turn_rad_s, abs=0.01)
        asyncio.get_running_loop().call_later(0.3, subject.abort)
        assert (await call(subject, 9027, 0.0, np.pi / 2, 0, 0, 0))[0] == 8
        assert (await call(subject, 0))[0] == 0

    play(scene)


def test_a_doubtful_distance_is_there_with_a_warning_and_any_code_can_be_forced() -> None:
    async def scene(subject: Instrument) -> None:
        await lock(subject)
        subject.tracker.doubtful = True
        await call(subject, 2008, 1, 1)
        code, (_, _, slope) = await call(subject, 2108, 1000, 1)
        assert code == 1284
        assert slope > 1.0
        subject.tracker.doubtful = False
        subject.forced[2108] = 1283
        await call(subject, 2008, 1, 1)
        code, (_, _, slope) = await call(subject, 2108, 1000, 1)
        assert code == 1283
        assert slope > 1.0
        subject.forced[2108] = 1290
        assert await call(subject, 2108, 1000, 1) == (1290, ())
        assert (await call(subject, 0))[0] == 0

    play(scene)


def test_a_frozen_meter_repeats_its_last_distance() -> None:
    async def scene(subject: Instrument) -> None:
        await lock(subject)
        await call(subject, 2008, 8, 1)
        await asyncio.sleep(0.2)
        subject.edm.freeze(True)
        before = await call(subject, 2082, 0, 1)
        await asyncio.sleep(0.2)
        assert await call(subject, 2082, 0, 1) == before
        subject.edm.freeze(False)
        assert await call(subject, 2082, 0, 1) != before

    play(scene)
