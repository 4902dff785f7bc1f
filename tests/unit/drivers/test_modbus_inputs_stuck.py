"""Inputs that do not change for longer than they may."""

import logging

import pytest

from drivers.digital import InputConfig, StuckWatch

INPUTS = {
    "xs": InputConfig(address=0, stuck_on_s=2.0, stuck_off_s=10.0),
    "ys": InputConfig(address=1),
}


@pytest.fixture
def subject() -> StuckWatch:
    watch = StuckWatch("beams", INPUTS)
    watch.begin(100.0, (0, 0))
    return watch


def test_an_input_is_stuck_once_its_own_limit_is_over(
    subject: StuckWatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    assert not subject.take(101.0, (False, True), (0, 0))
    assert not subject.take(105.0, (True, True), (1, 0))
    assert not subject.take(106.9, (True, True), (1, 0))
    assert subject.take(107.1, (True, True), (1, 0))
    assert subject.take(108.0, (True, True), (1, 0))
    assert subject.report(109.0) == {"xs": pytest.approx(4.0)}
    assert not subject.take(109.0, (False, True), (2, 0))
    assert subject.report(109.0) == {}
    assert [r.getMessage() for r in caplog.records] == [
        "beams: xs is stuck on: no change for 2.1 s",
        "beams: xs changes again after 4.0 s",
    ]


def test_off_has_a_limit_of_its_own(subject: StuckWatch) -> None:
    assert not subject.take(109.9, (False, False), (0, 0))
    assert subject.take(110.1, (False, False), (0, 0))


def test_a_pulse_between_two_polls_is_a_change(subject: StuckWatch) -> None:
    assert not subject.take(109.0, (False, False), (0, 0))
    assert not subject.take(110.5, (False, False), (2, 0))
    assert not subject.take(120.0, (False, False), (2, 0))
    assert subject.take(120.6, (False, False), (2, 0))


def test_a_new_epoch_begins_to_wait_anew(subject: StuckWatch) -> None:
    assert subject.take(120.0, (False, False), (0, 0))
    subject.begin(130.0, (0, 0))
    assert not subject.take(130.0, (False, False), (0, 0))
    assert subject.take(140.1, (False, False), (0, 0))
