"""A twin whose process stood still does not blame the client for kicks that it has not read yet."""

import pytest

from fakes.ur.inputs import InputOutput, Inputs


@pytest.fixture
def subject() -> Inputs:
    inputs = Inputs({}, InputOutput())
    inputs.arm_watchdog("input_int_register_0", 10.0, 0.0)
    return inputs


def test_a_client_that_is_silent_for_the_period_lets_the_watchdog_expire(subject: Inputs) -> None:
    assert not subject.watchdog_expired(0.09)
    assert subject.watchdog_expired(0.11)


def test_the_time_that_the_twin_itself_stood_still_does_not_count(subject: Inputs) -> None:
    subject.excuse(0.5, 0.52)
    assert not subject.watchdog_expired(0.55)
    assert subject.watchdog_expired(0.61)


def test_a_kick_that_was_read_right_after_it_does_not_hide_that_no_other_follows(subject: Inputs) -> None:
    subject.write({"input_int_register_0": 1}, 1.5)
    subject.excuse(1.5, 1.501)
    assert not subject.watchdog_expired(1.59)
    assert subject.watchdog_expired(1.61)
