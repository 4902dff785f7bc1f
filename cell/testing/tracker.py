"""What every tracker promises, on every face."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.laser_tracker import LaserTracker
from cell.poses import Array
from cell.testing.bench import Bench, Rig, known
from cell.testing.device import DeviceContract


@dataclass
class TrackerRig(Rig[LaserTracker]):
    """``where`` says where a reflector, m1 ... m4, is at a time, tracker frame (3,), for the truth."""

    where: Callable[[str, float], Array] | None = field(default=None, kw_only=True)

    def true(self, reflector: str) -> Array:
        """Where a reflector is now, tracker frame (3,)."""
        return known(self.where, "where")(reflector, self.clock.now())


WINDOW_S, SCATTER_M, TIMEOUT_S = 0.2, 1e-3, 10.0


async def failure_of(what: Coroutine[Any, Any, Any]) -> str:
    with pytest.raises(CellError) as caught:
        await what
    return caught.value.name


async def at(rig: TrackerRig, name: str) -> None:
    """Select a reflector and search where it is, about."""
    await rig.device.select(name)
    await rig.device.find(rig.true(name) + 0.01, TIMEOUT_S)


class TrackerContract(DeviceContract[TrackerRig]):
    """Points lie where the reflector is, and what hinders a measurement is told by name."""

    def test_an_instrument_says_its_version(self, subject: Bench[TrackerRig]) -> None:
        async def scene(rig: TrackerRig) -> None:
            assert (await rig.device.identify()).version

        subject(scene)

    @pytest.mark.parametrize("reflector", ["m1", "m4"])
    def test_a_reflector_is_measured_where_it_is_within_the_stated_noise(
        self, subject: Bench[TrackerRig], reflector: str
    ) -> None:
        subject.needs("truth")

        async def scene(rig: TrackerRig) -> None:
            await at(rig, reflector)
            asked = rig.clock.now()
            sample = await rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)
            true, noise = rig.true(reflector), rig.device.noise
            sigma = noise.sigma0_m + noise.sigma_per_m * float(np.linalg.norm(true))
            count = sample.value.count
            assert count >= 3
            # Six sigma of a mean of so many, along each axis.
            np.testing.assert_allclose(sample.value.point, true, atol=6 * sigma / np.sqrt(count))
            assert sample.value.scatter_m < 6 * sigma
            assert sample.t - sample.dt >= asked - 1e-9
            assert sample.t + sample.dt <= rig.clock.now() + 1e-9
            assert sample.value.temperature_c == pytest.approx(20.0, abs=20.0)
            assert sample.value.pressure_pa == pytest.approx(101e3, rel=0.1)
            assert sample.value.warnings == ()

        subject(scene)

    def test_the_stream_shows_the_point_while_it_is_locked(self, subject: Bench[TrackerRig]) -> None:
        subject.needs("truth")

        async def scene(rig: TrackerRig) -> None:
            await rig.device.wait_fresh(2.0)
            first = rig.device.readings.latest(1.0).value
            assert first.point is None
            assert not first.locked
            await at(rig, "m2")
            state = rig.device.readings.latest(1.0).value
            assert state.locked
            assert state.point is not None
            np.testing.assert_allclose(state.point, rig.true("m2"), atol=1e-3)
            await rig.device.wait_fresh(2.0)
            again = rig.device.readings.latest(1.0).value.point
            assert again is not None
            np.testing.assert_allclose(again, rig.true("m2"), atol=1e-3)

        subject(scene)

    def test_a_broken_beam_is_told_by_name_and_found_again_after_a_search(
        self,
        subject: Bench[TrackerRig],
    ) -> None:
        subject.needs("truth", "beam-break")

        async def scene(rig: TrackerRig) -> None:
            await at(rig, "m1")
            await rig.inject("beam-break")
            assert await failure_of(rig.device.measure(WINDOW_S, SCATTER_M, 3.0)) == "TRACKER_BEAM_BROKEN"
            assert not rig.device.readings.latest(2.0).value.locked
            assert await failure_of(rig.device.find(rig.true("m1"), 0.5)) == "TRACKER_NO_TARGET"
            await rig.inject("clear")
            await rig.device.find(rig.true("m1"), TIMEOUT_S)
            np.testing.assert_allclose(
                (await rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)).value.point,
                rig.true("m1"),
                atol=1e-3,
            )

        subject(scene)

    def test_where_no_reflector_is_none_is_found(self, subject: Bench[TrackerRig]) -> None:
        subject.needs("truth")

        async def scene(rig: TrackerRig) -> None:
            await rig.device.select("m1")
            behind = -rig.true("m1") * [1.0, 1.0, -1.0]
            assert await failure_of(rig.device.find(behind, 2.0)) == "TRACKER_NO_TARGET"

        subject(scene)

    def test_a_stand_that_shakes_gives_no_point(self, subject: Bench[TrackerRig]) -> None:
        subject.needs("truth", "vibration")

        async def scene(rig: TrackerRig) -> None:
            await at(rig, "m1")
            await rig.inject("vibration", m=0.002, hz=3.3)
            assert await failure_of(rig.device.measure(0.3, 5e-5, 0.8)) == "TRACKER_UNSTABLE"
            await rig.inject("clear")
            await rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)

        subject(scene)

    def test_data_that_the_instrument_doubts_are_valid_with_a_warning(
        self, subject: Bench[TrackerRig]
    ) -> None:
        subject.needs("truth", "doubtful")

        async def scene(rig: TrackerRig) -> None:
            await at(rig, "m1")
            await rig.inject("doubtful")
            sample = await rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)
            assert len(sample.value.warnings) == 1
            np.testing.assert_allclose(sample.value.point, rig.true("m1"), atol=1e-3)

        subject(scene)

    def test_the_constant_of_another_reflector_gives_no_point_until_one_is_selected_again(
        self,
        subject: Bench[TrackerRig],
    ) -> None:
        subject.needs("truth", "wrong-constant")

        async def scene(rig: TrackerRig) -> None:
            await at(rig, "m1")
            await rig.inject("wrong-constant", m=0.0169)
            assert await failure_of(rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)) == "TRACKER_SETTING"
            assert await failure_of(rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)) == "TRACKER_SETTING"
            await rig.device.select("m1")
            point = (await rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)).value.point
            np.testing.assert_allclose(point, rig.true("m1"), atol=3e-4)

        subject(scene)

    def test_an_unknown_reflector_is_told_by_name(self, subject: Bench[TrackerRig]) -> None:
        async def scene(rig: TrackerRig) -> None:
            assert await failure_of(rig.device.select("smr9")) == "TRACKER_REFLECTOR_UNKNOWN"

        subject(scene)

    @pytest.mark.parametrize("fault", ["silence", "drop"])
    def test_a_lost_link_ends_a_measurement_and_the_next_opening_is_a_new_epoch(
        self, subject: Bench[TrackerRig], fault: str
    ) -> None:
        subject.needs("truth", fault)

        async def scene(rig: TrackerRig) -> None:
            await at(rig, "m1")
            epoch = rig.device.readings.epoch

            async def break_it() -> None:
                await rig.clock.sleep(0.3)
                await rig.inject(fault)

            breaking = asyncio.create_task(break_it())
            assert await failure_of(rig.device.measure(8.0, SCATTER_M, 20.0)) == "DEVICE_LOST"
            await breaking
            assert getattr(await rig.device.wait_lost(), "name", "") == "DEVICE_LOST"
            assert await failure_of(rig.device.identify()) == "DEVICE_LOST"
            await rig.inject("clear")
            await rig.device.close()
            await rig.device.open()
            assert rig.device.readings.epoch == epoch + 1
            await at(rig, "m1")
            await rig.device.measure(WINDOW_S, SCATTER_M, TIMEOUT_S)

        subject(scene)
