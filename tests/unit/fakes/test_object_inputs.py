"""The input module, and the object face's driver of it: levels, counters, polls, edges and faults."""

from bisect import bisect_right
from collections.abc import Callable, Coroutine
from math import inf
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.devices import InputsState
from cell.errors import CellError
from cell.inputs import edges
from cell.poses import from_pose6
from cell.samples import Sample
from fakes.faults.inputs import InputFaults
from fakes.faults.vocabulary import Fault
from fakes.object import ObjectArm, ObjectInputs, VirtualClock, cell_of, run_virtual
from fakes.world.beams.beams import Beams
from fakes.world.beams.input_module import InputModule
from fakes.world.beams.truth import IoTruth
from fakes.world.scenario import FaultEntry

TOOL = from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0])
DOWN = Rotation.from_rotvec([np.pi, 0.0, 0.0])
Scene = Callable[[ObjectInputs], Coroutine[Any, Any, Any]]


class Sensors:
    """Beams that do what a list says: times at which each level changes, from clear at first."""

    version = foreseen = 0

    def __init__(self, **changes: list[float]) -> None:
        self.changes = changes

    def index(self, name: str, t: float) -> int:
        return bisect_right(self.changes[name], t)

    def level(self, name: str, t: float) -> bool:
        return self.index(name, t) % 2 == 1

    def edges(self, name: str, t0: float, t1: float) -> list[tuple[float, bool]]:
        return [(t, k % 2 == 0) for k, t in enumerate(self.changes[name]) if t0 < t <= t1]

    def quiet_until(self, name: str, t: float) -> float:
        return next((change for change in self.changes[name] if change > t), inf)


def module(changes: list[float], **truth: Any) -> InputModule:
    """A module with one input on channel 0."""
    table = IoTruth(**{"inputs": {"xs": 0}, "counters": True, **truth})
    return InputModule(table, cast(Beams, Sensors(xs=changes)), 0.0)


def shown(subject: InputModule, until: float = 2.0, step: float = 1e-4) -> list[float]:
    """When channel 0 changes its level, from looks in the order of time."""
    times = np.arange(0.0, until, step)
    levels = [subject.levels(float(t))[0] for t in times]
    return [float(times[k]) for k in range(1, len(times)) if levels[k] != levels[k - 1]]


# -- the module


def test_a_plain_module_shows_what_the_sensor_shows() -> None:
    subject = module([0.5, 0.75, 1.0, 1.25])
    assert shown(subject) == pytest.approx([0.5, 0.75, 1.0, 1.25], abs=1.01e-4)
    assert [subject.counts(t)[0] for t in (0.4, 0.6, 0.9, 1.1, 1.9)] == [0, 1, 1, 2, 2]


def test_channels_lie_where_the_wires_are_and_a_dark_on_sensor_is_on_while_its_beam_is_free() -> None:
    truth = IoTruth(inputs={"ys": 3, "xs": 1}, inverted=["ys"], counters=True)
    subject = InputModule(truth, cast(Beams, Sensors(xs=[1.0], ys=[2.0, 3.0])), 0.0)
    assert subject.levels(0.5) == (False, False, False, True)
    assert subject.levels(2.5) == (False, True, False, False)
    assert subject.counts(2.5) == (0, 1, 0, 0)
    assert subject.counts(3.5) == (0, 1, 0, 1)


def test_a_module_without_counters_has_none() -> None:
    assert module([0.5], counters=False).counts(1.0) == ()


def test_a_scan_shows_edges_at_its_own_looks_and_misses_what_comes_and_goes_between_two() -> None:
    subject = module([0.503, 0.7501, 1.001, 1.004], scan_s=0.01)
    assert shown(subject) == pytest.approx([0.51, 0.76], abs=1.01e-4)
    assert subject.counts(1.9) == (1,)


def test_a_filter_delays_and_swallows_short_pulses() -> None:
    subject = module([0.5, 0.75, 1.0, 1.002], filter_s=0.003)
    assert shown(subject) == pytest.approx([0.503, 0.753], abs=1.01e-4)
    assert subject.counts(1.9) == (1,)


def test_a_bouncing_contact_counts_several_times_unless_a_filter_holds_it_back() -> None:
    plain = module([0.5, 1.0], bounce_s=0.004)
    assert shown(plain) == pytest.approx(
        [0.5, 0.501, 0.502, 0.503, 0.504, 1.0, 1.001, 1.002, 1.003, 1.004], abs=1.01e-4
    )
    assert plain.counts(1.9) == (5,)
    filtered = module([0.5, 1.0], bounce_s=0.004, filter_s=0.002)
    assert shown(filtered) == pytest.approx([0.506, 1.006], abs=1.01e-4)
    assert filtered.counts(1.9) == (1,)


def test_pulses_of_4_ms_every_37_ms_are_all_counted_however_it_is_asked() -> None:
    pulses = [t for k in range(300) for t in (0.1 + 0.037 * k, 0.104 + 0.037 * k)]
    for scan_s, step in ((0.0, 0.02), (0.0, 0.7), (0.002, 0.005), (0.004, 3.0)):
        subject = module(pulses, scan_s=scan_s)
        for t in np.arange(0.0, 12.0, step):
            subject.levels(float(t))
        assert subject.counts(12.0) == (300,)


def test_asked_out_of_order_it_says_the_same() -> None:
    pulses = [t for k in range(60) for t in (0.1 + 0.1 * k, 0.15 + 0.1 * k)]
    ordered, wild = module(pulses, filter_s=0.001, scan_s=0.003), module(pulses, filter_s=0.001, scan_s=0.003)
    times = np.random.default_rng(1).uniform(0.0, 7.0, 300)
    expected = {float(t): (ordered.levels(float(t)), ordered.counts(float(t))) for t in np.sort(times)}
    assert all((wild.levels(t), wild.counts(t)) == value for t, value in expected.items())
    for t in times.tolist():
        assert (wild.levels(t), wild.counts(t)) == expected[t]


def test_an_image_that_is_asked_for_again_and_again_is_that_of_its_time() -> None:
    pulses = [t for k in range(60) for t in (0.1 + 0.1 * k, 0.15 + 0.1 * k)]
    for truth in ({}, {"filter_s": 0.001, "scan_s": 0.003}, {"bounce_s": 0.004}, {"filter_s": 0.06}):
        often, other = module(pulses, **truth), module(pulses, **truth)
        for t in np.arange(0.0, 7.0, 0.0017).tolist():
            assert often.image(t) == (other.levels(t), (other._inputs[0].count(t),))


# -- its faults


def test_an_image_shows_a_fault_as_soon_as_it_begins() -> None:
    subject = module([0.5])
    assert subject.image(1.0) == ((True,), (1,))
    subject.stick(1.1, False)
    assert subject.image(1.2) == ((False,), (1,))
    subject.stick(1.3, None)
    assert subject.image(1.4) == ((True,), (2,))
    subject.preset(1.5, 7)
    assert subject.image(1.6) == ((True,), (7,))
    subject.freeze(1.7, True)
    subject.stick(1.8, False)
    assert subject.image(1.9) == ((True,), (7,))
    subject.freeze(2.0, False)
    assert subject.image(2.1) == ((False,), (7,))


def test_an_image_of_just_before_a_fault_is_not_kept_beyond_it() -> None:
    """A poll that was under way when a fault began is made after it, for a time before it."""
    subject = module([0.5])
    subject.preset(1.0, 7)
    assert subject.image(0.99) == ((True,), (1,))
    assert subject.image(1.01) == ((True,), (7,))
    subject.stick(2.0, False)
    assert subject.image(1.99) == ((True,), (7,))
    assert subject.image(2.01) == ((False,), (7,))
    subject.reboot(3.0)
    assert subject.image(2.99) == ((False,), (7,))
    assert subject.image(3.01) == ((False,), (0,))


def test_a_stuck_contact_keeps_its_level_and_jumps_back_when_it_is_freed() -> None:
    subject = module([0.5, 0.75, 1.0, 1.25])
    assert subject.levels(0.6) == (True,)
    subject.stick(0.8, True)
    assert subject.levels(0.7) == (True,)
    assert [subject.levels(t)[0] for t in (0.79, 0.81, 1.1, 1.4)] == [False, True, True, True]
    assert subject.counts(1.4) == (2,)
    subject.stick(1.5, None)
    assert subject.levels(1.6) == (False,)
    assert subject.counts(1.6) == (2,)


def test_only_the_named_input_sticks() -> None:
    truth = IoTruth(inputs={"xs": 0, "ys": 1})
    subject = InputModule(truth, cast(Beams, Sensors(xs=[], ys=[])), 0.0)
    subject.stick(1.0, True, "ys")
    assert subject.levels(1.0) == (False, True)


def test_a_preset_counter_wraps() -> None:
    subject = module([0.1 * k for k in range(1, 15)])
    assert subject.counts(0.35) == (2,)
    subject.preset(0.36, InputModule.MODULUS - 2)
    assert [subject.counts(t)[0] for t in (0.35, 0.4, 0.55, 0.75, 0.95)] == [2, 2**32 - 2, 2**32 - 1, 0, 1]


def test_a_reboot_sets_the_counters_to_zero_and_ends_a_freeze() -> None:
    subject = module([0.1 * k for k in range(1, 15)])
    subject.freeze(0.35, True)
    assert subject.levels(0.45) == subject.levels(0.35)
    assert subject.counts(0.9) == (2,)
    subject.reboot(0.91)
    assert subject.counts(0.91) == (0,)
    assert subject.counts(1.15) == (1,)
    assert subject.counts(0.8) == (2,), "the past stays as it was shown"


def test_a_frozen_image_stands_still_while_the_module_counts_on() -> None:
    subject = module([0.1 * k for k in range(1, 15)])
    subject.freeze(0.35, True)
    assert subject.counts(0.95) == (2,)
    subject.freeze(0.96, False)
    assert subject.counts(0.96) == (5,)


def test_clear_ends_what_lasts_and_leaves_what_the_scenario_says() -> None:
    subject = module([0.5, 0.75, 1.0], bounce_s=0.002)
    subject.stick(0.6, False)
    subject.bounce(0.6, 0.02)
    subject.freeze(0.6, True)
    subject.clear(0.7)
    assert subject.levels(0.71) == (True,)
    assert subject.counts(0.9) == (1 + 2 + 1 + 2,)  # on and two bounces; freed; the last two while going off


def test_faults_have_the_names_of_the_vocabulary_and_check_what_they_are_given() -> None:
    subject = module([0.5])
    now = 1.0
    faults = InputFaults(subject, lambda: now)
    assert faults.offers() == {Fault.STUCK, Fault.BOUNCE, Fault.WRAP, Fault.FREEZE}
    faults.inject(Fault.STUCK, {"input": "xs", "level": "off"})
    assert subject.levels(1.0) == (False,)
    faults.inject(Fault.WRAP, {"before": 1})
    assert subject.counts(1.0) == (2**32 - 1,)
    faults.clear()
    assert subject.levels(1.0) == (True,)
    for fault, arguments, said in (
        (Fault.STUCK, {"input": "zs"}, "there are xs"),
        (Fault.STUCK, {"level": "high"}, "neither on nor off"),
        (Fault.BOUNCE, {"s": "long"}, "not a number"),
        (Fault.FREEZE, {"before": 1}, "does not take before"),
    ):
        with pytest.raises(CellError, match=said):
            faults.inject(fault, arguments)


def test_an_input_module_is_checked_when_it_is_read() -> None:
    for table, said in (
        ({"inputs": {"xs": 0, "ys": 0}}, "two beams on one channel"),
        ({"module": "ADAM-6050", "inputs": {"xs": 12}}, "channels 0..11"),
        ({"inverted": ["xs"]}, "not among its inputs"),
        ({"serial": "12345"}, "serial"),
    ):
        with pytest.raises(ValueError, match=said):
            IoTruth(**cast(Any, table))


# -- the driver


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


def test_an_input_whose_beam_was_never_broken_is_off_and_has_counted_nothing() -> None:
    subject = module([], bounce_s=0.01)
    assert subject.levels(1e6) == (False,)
    assert subject.counts(inf) == (0,)
