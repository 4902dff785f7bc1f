"""The input module of the twin: levels, counters, filter, scan, bounces, and its own faults."""

from bisect import bisect_right
from math import inf
from typing import Any, cast

import numpy as np
import pytest

from cell.errors import CellError
from fakes.faults.inputs import InputFaults
from fakes.faults.vocabulary import Fault
from fakes.world.beams.beams import Beams
from fakes.world.beams.input_module import InputModule
from fakes.world.beams.truth import IoTruth


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


def test_an_input_whose_beam_was_never_broken_is_off_and_has_counted_nothing() -> None:
    subject = module([], bounce_s=0.01)
    assert subject.levels(1e6) == (False,)
    assert subject.counts(inf) == (0,)


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
