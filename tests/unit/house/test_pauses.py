"""The judge of runs that were interrupted: a step that no pause explains fails the test."""

import pytest

from tests.kit.pauses import LONG_S, Pauses


@pytest.fixture
def subject() -> Pauses:
    return Pauses()


def test_a_step_that_was_taken_again_without_a_pause_is_refused(subject: Pauses) -> None:
    subject.woken(0.9 * LONG_S)
    subject.require_explained(0)
    with pytest.raises(AssertionError, match="1 steps were taken again, but this machine paused 0 times"):
        subject.require_explained(1)


def test_as_many_steps_as_pauses_are_explained_and_no_more(subject: Pauses) -> None:
    for late_s in (2 * LONG_S, 0.4):
        subject.woken(late_s)
    subject.require_explained(2)
    with pytest.raises(AssertionError, match=r"0\.400 s at most"):
        subject.require_explained(3)
    subject.forget()
    with pytest.raises(AssertionError):
        subject.require_explained(1)


def test_a_quiet_machine_ends_its_thread(subject: Pauses) -> None:
    subject.start()
    subject.stop()
    assert not subject._thread.is_alive()
