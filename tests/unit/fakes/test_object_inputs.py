"""The object face's driver of an input module: polls, brackets, edges, epochs, and faults as it sees them."""

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.devices import InputsState
from cell.errors import CellError
from cell.inputs import edges
from cell.poses import from_pose6
from cell.samples import Sample
from fakes.object import ObjectArm, ObjectInputs, VirtualClock, cell_of, run_virtual
from fakes.world.beams.input_module import InputModule
from fakes.world.scenario import FaultEntry

TOOL = from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0])
DOWN = Rotation.from_rotvec([np.pi, 0.0, 0.0])
Scene = Callable[[ObjectInputs], Coroutine[Any, Any, Any]]


@pytest.fixture
def subject() -> Callable[..., Any]:
    def play(scene: Scene, **config: Any) -> Any:
        async def whole() -> Any:
            inputs = ObjectInputs(
                "beams", ObjectInputs.Config(scenario="laser:ideal", **config), VirtualClock()
            )
            await inputs.open()
            try:
                return await scene(inputs)
            finally:
                await inputs.close()

        return run_virtual(whole())

    return play


def cross(inputs: ObjectInputs, way: float = 0.03, v: float = 0.02, lower: float = 0.012) -> float:
    """Move the pin across xs, from beside it; returns when it rests."""
    world, now = inputs.world, inputs.clock.now()
    start = np.add(world.config.beams["xs"].point, [0.025, -way / 2, 0.008 - lower])
    q = world.believed.inverse(
        RigidTransform.from_components(start, DOWN) * TOOL.inv(), world.track.at(now)[0]
    )
    world.track.hold(now, q)
    goal = RigidTransform.from_components(np.add(start, [0.0, way, 0.0]), DOWN)
    return world.track.start_linear_move(now + 0.1, world.believed, goal, TOOL, v, 0.5)


async def polls(inputs: ObjectInputs, until: float) -> list[Sample[InputsState]]:
    """Every poll up to ``until``."""
    found: list[Sample[InputsState]] = []
    unsubscribe = inputs.inputs.subscribe(found.append)
    await inputs.clock.sleep(until - inputs.clock.now())
    unsubscribe()
    return found


def test_every_poll_reaches_a_subscriber_and_the_brackets_enclose_the_true_edges(
    subject: Callable[..., Any],
) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        assert inputs.names == ("xs", "ys")
        end = cross(inputs)
        begin = inputs.clock.now()
        seen = await polls(inputs, end + 0.1)
        assert len(seen) == pytest.approx((end + 0.1 - begin) / 0.005, abs=2)
        assert np.diff([s.t for s in seen]) == pytest.approx(0.005, abs=1e-9)
        assert {s.dt for s in seen} == {0.00025}
        found = edges(seen, 0)
        truth = inputs.world.beams.edges("xs", begin, end)
        assert [e.rising for e in found] == [True, False] == [level for _, level in truth]
        for edge, (t, _) in zip(found, truth, strict=True):
            assert abs(edge.t - t) <= edge.dt
            assert edge.dt == pytest.approx(0.00275, abs=1e-6)
        assert edges(seen, 1) == []

    subject(scene)


def test_polls_see_a_way_that_is_commanded_after_a_long_rest(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        ended = cross(inputs)
        for _ in range(3):
            await polls(inputs, ended + 1.0)
            begin, ended = inputs.clock.now(), cross(inputs)
            await polls(inputs, ended - 0.5)
            ended = inputs.world.track.stop_linear(inputs.clock.now(), 2.0)
            seen = inputs.inputs.between(begin, inputs.clock.now())
            truth = inputs.world.beams.edges("xs", begin, seen[-1].t)
            assert len(truth) == 2
            for edge, (t, rising) in zip(edges(seen, 0), truth, strict=True):
                assert edge.rising is rising
                assert abs(edge.t - t) <= edge.dt

    subject(scene)


def test_a_pulse_between_two_polls_is_seen_by_a_module_that_counts(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> int:
        end = cross(inputs, v=0.5, way=0.1)
        seen = await polls(inputs, end + 0.3)
        assert not any(s.value.levels[0] for s in seen)
        return len(edges(seen, 0))

    assert subject(scene, poll_period_s=0.2) == 2


def test_a_module_without_counters_shows_only_what_polls_find(
    subject: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(InputModule, "image", lambda self, t: (self.levels(t), ()))

    async def scene(inputs: ObjectInputs) -> int:
        end = cross(inputs)
        seen = await polls(inputs, end + 0.1)
        assert [s.value.changes[0] % 2 for s in seen] == [s.value.levels[0] for s in seen]
        return len(edges(seen, 0))

    assert subject(scene) == 2

    async def between(inputs: ObjectInputs) -> int:
        end = cross(inputs, v=0.5, way=0.1)
        seen = await polls(inputs, end + 0.3)
        assert inputs.world.beams.count("xs", end) == 1
        return len(edges(seen, 0))

    assert subject(between, poll_period_s=0.2) == 0


def test_the_known_delay_is_taken_off_the_stamps(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> tuple[float, float]:
        end = cross(inputs)
        seen = await polls(inputs, end + 0.1)
        (on, _) = inputs.world.beams.edges("xs", 0.0, end)
        return edges(seen, 0)[0].t, on[0]

    stamped, true = subject(scene, poll_period_s=0.001, time_offset_s=0.002)
    assert true - 0.002 == pytest.approx(stamped, abs=0.001)
    stamped, true = subject(scene, poll_period_s=0.001)
    assert true == pytest.approx(stamped, abs=0.001)


def test_a_stuck_input_is_logical_like_any_level(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        inputs.inject("stuck", input="ys", level="on", duration_s=0.5)
        await inputs.wait_fresh(1.0)
        assert inputs.inputs.latest(0.1).value == InputsState((False, True), (0, 1))
        await inputs.clock.sleep(0.6)
        assert inputs.inputs.latest(0.1).value == InputsState((False, False), (0, 2))

    subject(scene)


def test_a_counter_that_wraps_between_two_polls_goes_on(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        inputs.inject("wrap", before=1)
        await inputs.wait_fresh(1.0)
        before = inputs.inputs.latest(0.1).value.changes
        end = cross(inputs)
        seen = await polls(inputs, end + 0.1)
        assert seen[-1].value.changes[0] == before[0] + 2
        assert inputs.input_plant.inputs.counts(end)[0] == 0

    subject(scene)


def test_a_frozen_module_answers_with_old_levels(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        end = cross(inputs)
        inputs.inject("freeze")
        seen = await polls(inputs, end + 0.1)
        assert len(seen) > 100
        assert edges(seen, 0) == []
        inputs.inject("clear")
        await inputs.wait_fresh(1.0)
        assert inputs.inputs.latest(0.1).value.changes[0] == 2

    subject(scene)


def test_a_module_that_reboots_is_lost_and_counts_from_zero_in_a_new_epoch(
    subject: Callable[..., Any],
) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        end = cross(inputs)
        await inputs.clock.sleep(end - inputs.clock.now() + 0.1)
        assert inputs.input_plant.inputs.counts(inputs.clock.now()) == (1, 0)
        epoch = inputs.inputs.epoch
        inputs.inject("reboot", serial="99993300002", boot_s=0.5)
        assert "restarts" in str(await inputs.wait_lost())
        with pytest.raises(CellError, match="refuses"):
            await inputs.open()
        await inputs.clock.sleep(0.6)
        await inputs.open()
        assert (await inputs.identify()).serial == "99993300002"
        assert inputs.inputs.epoch > epoch
        await inputs.wait_fresh(1.0)
        assert inputs.inputs.latest(0.1).value == InputsState((False, False), (0, 0))
        assert inputs.input_plant.inputs.counts(inputs.clock.now()) == (0, 0)

    subject(scene)


def test_the_identity_is_the_scenarios_and_another_one_is_refused(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        identity = await inputs.identify()
        assert identity.is_twin
        assert identity.model == "ioLogik-E1210"

    subject(scene)

    async def wrong(inputs: ObjectInputs) -> None:
        with pytest.raises(CellError, match="expected 99993300009"):
            await inputs.identify()

    subject(wrong, expect_serial="99993300009")


@pytest.mark.parametrize(
    ("kind", "lost"), [("drop", True), ("refuse", True), ("silence", True), ("gap", False)]
)
def test_the_link_shows_the_faults_of_every_link(subject: Callable[..., Any], kind: str, lost: bool) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        await inputs.wait_fresh(1.0)
        inputs.inject(kind)
        await inputs.clock.sleep(0.5)
        assert (inputs.lost is not None) == lost
        assert inputs.health()["gaps"] == (0 if lost else 10)

    subject(scene)


def test_a_fault_of_the_scenario_reaches_the_module() -> None:
    async def scene() -> tuple[bool, ...]:
        clock = VirtualClock()
        cell_of("laser:ideal", clock).inject(
            FaultEntry(device="beams", kind="stuck", when_s=0.0, args={"input": "xs"})
        )
        return cell_of("laser:ideal", clock).inputs.inputs.levels(clock.now())

    assert run_virtual(scene()) == (True, False)


def test_the_arms_own_inputs_carry_the_beams_too(subject: Callable[..., Any]) -> None:
    async def scene(inputs: ObjectInputs) -> None:
        arm = ObjectArm("arm", ObjectArm.Config(scenario="laser:ideal", state_period_s=0.002), inputs.clock)
        await arm.open()
        end = cross(inputs)
        seen: list[tuple[float, int]] = []
        unsubscribe = arm.state.subscribe(lambda s: seen.append((s.t, s.value.digital_in)))
        await inputs.clock.sleep(end - inputs.clock.now())
        unsubscribe()
        (on, _), (off, _) = inputs.world.beams.edges("xs", 0.0, end)
        lit = [t for t, word in seen if word]
        assert {word for _, word in seen} == {0, 1}
        assert 0.0 <= lit[0] - on <= 0.002
        assert -0.002 <= lit[-1] - off <= 0.0
        # An arm at rest still sees its inputs: here a bend moves the tool into the beam.
        point = np.array(inputs.world.config.beams["xs"].point)
        tip = inputs.world.true_flange(end) * TOOL
        shift = tip.rotation.inv().apply([0.0, point[1] - tip.translation[1], 0.0])
        inputs.world.tool.bend(inputs.clock.now(), shift)
        await inputs.clock.sleep(0.01)
        assert arm.state.latest(0.1).value.digital_in == 1
        await arm.close()

    subject(scene)


def test_a_scenario_without_a_module_has_no_inputs() -> None:
    async def scene() -> None:
        with pytest.raises(CellError, match="the scenario has no beams"):
            ObjectInputs("beams", ObjectInputs.Config(scenario="hand_eye:ideal"), VirtualClock())

    run_virtual(scene())
