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
    subject.excuse(0.5)
    assert not subject.watchdog_expired(0.55)
    assert subject.watchdog_expired(0.61)
