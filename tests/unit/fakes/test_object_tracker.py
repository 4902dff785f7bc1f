"""The object face's laser tracker: finding, measuring, what goes wrong, on virtual time."""

import asyncio
from collections.abc import Callable, Coroutine
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.laser_tracker import LaserTracker
from cell.poses import Array
from fakes.object import ObjectTracker, VirtualClock, cell_of, run_virtual
from fakes.world.scenario import FaultEntry

SCENARIO = "tracker:ideal"
SMR = np.array([-0.05, 0.0, 0.06])  # smr1 in the flange
Scene = Callable[[ObjectTracker], Coroutine[Any, Any, Any]]


def play(scene: Scene, scenario: str = SCENARIO, **config: Any) -> Any:
    """Run ``scene`` with an open tracker that is set to smr1."""

    async def whole() -> Any:
        subject = ObjectTracker("tracker", ObjectTracker.Config(scenario=scenario, **config), VirtualClock())
        await subject.open()
        await subject.select("smr1")
        try:
            return await scene(subject)
        finally:
            await subject.close()

    return run_virtual(whole())


def expected(subject: ObjectTracker, name: str = "smr1", off: float = 0.0) -> Array:
    """Where the reflector is in the tracker frame, ``off`` m beside it along x."""
    tracker = subject.world.tracker
    assert tracker is not None
    out: Array = tracker.visibility.local(name, subject.clock.now()) + np.array([off, 0.0, 0.0])
    return out


async def fails(work: Coroutine[Any, Any, Any]) -> str:
    with pytest.raises(CellError) as caught:
        await work
    return caught.value.name


def test_it_offers_what_a_laser_tracker_offers() -> None:
    async def scene(subject: ObjectTracker) -> None:
        assert isinstance(subject, LaserTracker)
        identity = await subject.identify()
        assert identity.serial == "99994400001"
        assert identity.is_twin
        assert subject.noise.sigma0_m == 15e-6
        assert subject.noise.sigma_per_m == 6e-6

    play(scene)


def test_a_stable_point_is_the_truth_within_the_noise_of_its_mean() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.select("smr1")
        await subject.find(expected(subject, off=0.02), 5.0)
        asked = subject.clock.now()
        sample = await subject.measure(1.0, 2e-4, 5.0)
        point = sample.value
        assert sample.t - sample.dt >= asked - 1e-9
        assert sample.t + sample.dt <= subject.clock.now() + 1e-9
        assert point.window_s == 1.0
        assert 45 <= point.count <= 51
        sigma = 15e-6 + 6e-6 * np.linalg.norm(point.point)
        assert np.abs(point.point - expected(subject)).max() < 5 * sigma / np.sqrt(point.count)
        assert point.scatter_m == pytest.approx(np.sqrt(3) * sigma, rel=0.4)
        assert point.temperature_c == 20.0
        assert point.pressure_pa == 101325.0
        assert point.warnings == ()

    play(scene)


def test_it_locks_the_reflector_nearest_to_where_it_is_sent() -> None:
    async def scene(subject: ObjectTracker) -> None:
        for name in ("m2", "smr1", "m4"):
            await subject.find(expected(subject, name, off=0.01), 5.0)
            sample = await subject.measure(0.2, 2e-4, 2.0)
            assert sample.value.point == pytest.approx(expected(subject, name), abs=1e-4)

    play(scene)


def test_it_follows_the_arm_and_its_readings_tell_where_it_truly_is() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        arm = cell_of(SCENARIO, subject.clock).world.track
        q = np.array([0.6, -1.7, 1.7, -0.1, 1.57, 0.2])
        end = arm.start_joint_move(subject.clock.now(), q, 0.3, 0.5)
        await subject.clock.sleep(end - subject.clock.now() + 0.3)
        states = subject.readings.between(end + 0.05, subject.clock.now())
        assert states
        assert all(state.value.locked for state in states)
        assert states[-1].value.point == pytest.approx(expected(subject), abs=3e-4)

    play(scene)


def test_a_station_makes_a_point_of_few_distances_which_take_seconds(tmp_path: Path) -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        begun = subject.clock.now()
        point = (await subject.measure(1.0, 0.01, 10.0)).value
        assert point.count == 3
        assert subject.clock.now() - begun == pytest.approx(6.0, abs=0.5)
        subject.inject("beam-break", duration_s=0.1)  # none of its distances need fall into that
        assert await fails(subject.measure(1.0, 0.01, 10.0)) == "TRACKER_BEAM_BROKEN"

    text = files("fakes").joinpath("scenarios", "tracker.toml").read_text("utf-8")
    station = "one_by_one = true\nmeasure_s = 2.0\nrate_hz = 5.0\nsigma0_m = 0.001"
    path = tmp_path / "station.toml"
    path.write_text(text.replace("sigma0_m = 15e-6", station), "utf-8")
    play(scene, str(path))


def test_a_place_without_a_reflector_is_told_after_the_time_allowed() -> None:
    async def scene(subject: ObjectTracker) -> None:
        begun = subject.clock.now()
        assert await fails(subject.find(expected(subject, off=2.0), 3.0)) == "TRACKER_NO_TARGET"
        assert 3.0 <= subject.clock.now() - begun < 5.0
        assert await fails(subject.measure(0.2, 1e-3, 1.0)) == "TRACKER_NO_TARGET"

    play(scene)


def test_a_broken_beam_is_told_and_only_a_search_finds_the_reflector_again() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        subject.inject("beam-break", duration_s=0.5)
        assert await fails(subject.measure(0.2, 1e-3, 2.0)) == "TRACKER_BEAM_BROKEN"
        await subject.clock.sleep(2.0)
        assert await fails(subject.measure(0.2, 1e-3, 2.0)) == "TRACKER_BEAM_BROKEN"
        state = subject.readings.latest(0.1).value
        assert not state.locked
        assert state.point is None
        assert "broken" in state.status
        await subject.find(None, 2.0)
        await subject.measure(0.2, 1e-3, 2.0)

    play(scene)


def test_a_search_waits_for_a_beam_that_is_freed_in_time() -> None:
    async def scene(subject: ObjectTracker) -> None:
        subject.inject("beam-break", duration_s=3.0)
        await subject.find(expected(subject), 6.0)
        assert subject.readings.latest(0.1).value.locked

    play(scene)


def test_a_beam_broken_in_the_middle_of_a_window_spoils_it() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        asyncio.get_running_loop().call_later(0.5, lambda: subject.inject("beam-break", for_s=0.01))
        assert await fails(subject.measure(1.0, 1e-3, 5.0)) == "TRACKER_BEAM_BROKEN"

    play(scene)


def test_a_reflector_that_faces_elsewhere_is_no_target_until_it_is_turned_back() -> None:
    async def scene(subject: ObjectTracker) -> None:
        subject.inject("out-of-view", reflector="smr1")
        assert await fails(subject.find(expected(subject), 1.0)) == "TRACKER_NO_TARGET"
        subject.inject("clear")
        await subject.find(expected(subject), 1.0)

    play(scene)


def test_vibration_is_unstable_until_it_ends() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        subject.inject("vibration", m=0.0005, hz=3.0)
        with pytest.raises(CellError, match=r"scatter 0\.\d+ mm, limit 0\.150 mm") as caught:
            await subject.measure(0.5, 150e-6, 3.0)
        assert caught.value.name == "TRACKER_UNSTABLE"
        asyncio.get_running_loop().call_later(1.0, lambda: subject.inject("clear"))
        sample = await subject.measure(0.5, 150e-6, 5.0)
        assert sample.value.point == pytest.approx(expected(subject), abs=1e-4)

    play(scene)


def test_a_pushed_stand_shows_in_every_reflector() -> None:
    async def scene(subject: ObjectTracker) -> None:
        before = {}
        for name in ("m1", "m2"):
            await subject.find(expected(subject, name), 5.0)
            before[name] = (await subject.measure(1.0, 2e-4, 5.0)).value.point
        subject.inject("stand-moved", dx=0.0, dy=0.0008, dz=0.0)
        for name in ("m1", "m2"):
            await subject.find(expected(subject, name), 5.0)
            moved = (await subject.measure(1.0, 2e-4, 5.0)).value.point - before[name]
            assert np.linalg.norm(moved) == pytest.approx(0.0008, abs=4e-5)

    play(scene)


def test_a_constant_set_behind_our_back_lengthens_the_range_and_gives_no_point_until_one_is_selected() -> (
    None
):
    async def scene(subject: ObjectTracker) -> None:
        await subject.select("smr1")
        await subject.find(expected(subject), 5.0)
        for after_s in (0.0, 0.3):  # before a measurement, and in the middle of one
            measuring = asyncio.create_task(fails(subject.measure(0.5, 0.1, 5.0)))
            await subject.clock.sleep(after_s)
            subject.inject("wrong-constant", m=0.01)
            assert await measuring == "TRACKER_SETTING"
            wrong = subject.readings.latest(1.0).value.point
            true = expected(subject)
            assert np.linalg.norm(wrong) - np.linalg.norm(true) == pytest.approx(0.01, abs=1e-4)
            assert await fails(subject.measure(0.5, 2e-4, 5.0)) == "TRACKER_SETTING"
            await subject.select("smr1")
        right = (await subject.measure(0.5, 2e-4, 5.0)).value.point
        assert right == pytest.approx(true, abs=5e-5)
        assert await fails(subject.select("smr9")) == "TRACKER_REFLECTOR_UNKNOWN"

    play(scene)


def test_nothing_is_measured_before_a_reflector_was_selected_for_this_connection() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        await subject.measure(0.2, 1e-3, 2.0)
        await subject.close()
        await subject.open()
        assert await fails(subject.measure(0.2, 1e-3, 2.0)) == "TRACKER_SETTING"
        await subject.select("smr1")
        await subject.measure(0.2, 1e-3, 2.0)

    play(scene)


def test_a_doubtful_point_is_valid_and_warned_of() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        subject.inject("doubtful")
        point = (await subject.measure(0.5, 2e-4, 5.0)).value
        assert point.point == pytest.approx(expected(subject), abs=1e-4)
        assert "vouch" in point.warnings[0]

    play(scene)


def test_a_lost_link_ends_find_and_measure_at_once() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        for work in (subject.measure(5.0, 1e-3, 20.0), subject.find(expected(subject, off=1.0), 20.0)):
            asyncio.get_running_loop().call_later(0.3, lambda: subject.inject("drop"))
            begun = subject.clock.now()
            assert await fails(work) == "DEVICE_LOST"
            assert subject.clock.now() - begun < 0.5
            await subject.open()
            await subject.select("smr1")

    play(scene)


def test_a_silent_instrument_is_lost_after_a_while() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        subject.inject("silence")
        assert await fails(subject.measure(0.5, 1e-3, 20.0)) == "DEVICE_LOST"

    play(scene, lost_after_s=1.0)


def test_after_a_restart_it_follows_nothing_and_may_be_another_instrument() -> None:
    async def scene(subject: ObjectTracker) -> None:
        await subject.find(expected(subject), 5.0)
        subject.inject("reboot", serial="99994400002", boot_s=1.0)
        await subject.clock.sleep(2.0)
        await subject.open()
        assert await fails(subject.identify()) == "DEVICE_IDENTITY"
        await subject.select("smr1")
        assert await fails(subject.measure(0.5, 1e-3, 1.0)) == "TRACKER_NO_TARGET"

    play(scene, expect_serial="99994400001")


def test_faults_are_refused_that_name_what_there_is_not() -> None:
    async def scene(subject: ObjectTracker) -> None:
        for kind, arguments, said in (
            ("beam-break", {"reflector": "smr9"}, "there are smr1, smr2"),
            ("vibration", {"amplitude": 1.0}, "does not take amplitude"),
            ("stand-moved", {"dx": "far"}, "not a number"),
            ("dark", {}, "tracker has no fault 'dark'"),
        ):
            with pytest.raises(CellError, match=said):
                subject.inject(kind, **arguments)

    play(scene)


def test_the_scenario_says_when_a_fault_happens() -> None:
    async def scene(subject: ObjectTracker) -> None:
        cell = cell_of(SCENARIO, subject.clock)
        cell.inject(FaultEntry(device="tracker", kind="beam-break", when_s=0.0))
        assert cell.world.truth(subject.clock.now())["tracker"]["reflectors"]["m1"]["hindrance"]

    play(scene)
