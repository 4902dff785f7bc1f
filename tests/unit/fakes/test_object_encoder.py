"""The belt's encoder on virtual time: exact counts, pauses, and what ends its link."""

from collections.abc import Callable, Coroutine
from math import floor
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from fakes.object import ObjectEncoder, VirtualClock, run_virtual
from fakes.world.belt.belt import Belt

Scene = Callable[[ObjectEncoder, Belt, VirtualClock], Coroutine[Any, Any, None]]
HEAD = """
schema = "cellward.scenario/1"
[world.arm]
model = "ur10e"
q_start = [0.0, -1.8, 1.8, -1.57, -1.57, 0.0]
[world.belt]
modulus = 5000
count_at_start = 4900
"""


def play(folder: Path, scene: Scene, more: str = "", **config: Any) -> None:
    """Run ``scene`` with an open encoder; ``more`` is added to the scenario."""
    path = folder / "scenario.toml"
    path.write_text(HEAD + more, "utf-8")

    async def whole() -> None:
        clock = VirtualClock()
        subject = ObjectEncoder("belt", ObjectEncoder.Config(scenario=str(path), **config), clock)
        await subject.open()
        assert subject.world.belt is not None
        await scene(subject, subject.world.belt, clock)
        await subject.close()

    run_virtual(whole())


def test_every_count_is_the_travel_of_its_time(tmp_path: Path) -> None:
    async def scene(subject: ObjectEncoder, belt: Belt, clock: VirtualClock) -> None:
        await clock.sleep(2.0)
        samples = subject.counts.between(0.0, clock.now())
        assert len(samples) == 200, "what a reader finds after a pause is a second of samples"
        first = floor(belt.travel_at(samples[0].t) / 1e-4 + 0.5) - samples[0].value.count
        for sample in samples:
            assert sample.value.count + first == floor(belt.travel_at(sample.t) / 1e-4 + 0.5)
            assert sample.value.raw == (4900 + sample.value.count + first) % 5000

    play(tmp_path, scene, "ripple = [{ amplitude = 0.02, hz = 0.8 }]\n")


def test_counts_go_on_over_a_pause_in_which_the_range_wraps_many_times(tmp_path: Path) -> None:
    async def scene(subject: ObjectEncoder, belt: Belt, clock: VirtualClock) -> None:
        await clock.sleep(0.1)
        before = subject.counts.latest(0.1)
        await clock.sleep(100.0)
        after = subject.counts.latest(0.1)
        moved = belt.travel_at(after.t) - belt.travel_at(before.t)
        assert moved > 10.0
        assert 1e-4 * (after.value.count - before.value.count) == pytest.approx(moved, abs=1.1e-4)

    play(tmp_path, scene)


def test_a_known_delay_is_taken_out_of_the_stamps(tmp_path: Path) -> None:
    async def scene(subject: ObjectEncoder, belt: Belt, clock: VirtualClock) -> None:
        await clock.sleep(0.5)
        last = subject.counts.latest(0.1)
        shown = 1e-4 * ((last.value.raw - 4900) % 5000)
        assert shown == pytest.approx(belt.travel_at(last.t + 0.02), abs=1e-4)

    play(tmp_path, scene, time_offset_s=0.02)


def test_faults_of_the_scenario_happen_at_their_time(tmp_path: Path) -> None:
    async def scene(subject: ObjectEncoder, belt: Belt, clock: VirtualClock) -> None:
        await clock.sleep(0.9)
        assert belt.speed_at(clock.now()) == pytest.approx(0.15)
        await clock.sleep(0.3)
        assert belt.speed_at(clock.now()) == 0.0

    stop = '[[fault]]\ndevice = "belt"\nkind = "belt-stop"\nwhen_s = 1.0\nargs = { accel = 5.0 }\n'
    play(tmp_path, scene, stop)


def test_an_incremental_encoder_begins_at_zero_in_a_new_epoch(tmp_path: Path) -> None:
    async def scene(subject: ObjectEncoder, belt: Belt, clock: VirtualClock) -> None:
        await clock.sleep(0.5)
        epoch = subject.counts.epoch
        subject.inject("reboot", boot_s=0.05)
        await subject.wait_fresh(1.0)
        first = subject.counts.between(0.0, clock.now())[0]
        assert subject.counts.epoch == epoch + 1
        assert (first.value.count, first.value.raw) == (0, 0)

    play(tmp_path, scene, "keeps_position = false\n")


def test_a_restart_that_takes_longer_than_the_watch_loses_the_link(tmp_path: Path) -> None:
    async def scene(subject: ObjectEncoder, belt: Belt, clock: VirtualClock) -> None:
        subject.inject("reboot", boot_s=2.0)
        asked = clock.now()
        assert isinstance(await subject.wait_lost(), CellError)
        assert clock.now() - asked == pytest.approx(0.25, abs=0.01)

    play(tmp_path, scene)


def test_a_config_that_expects_another_encoder_is_told(tmp_path: Path) -> None:
    async def scene(subject: ObjectEncoder, belt: Belt, clock: VirtualClock) -> None:
        with pytest.raises(CellError, match="999966001, expected 999966002"):
            await subject.identify()

    play(tmp_path, scene, expect_serial="999966002")
