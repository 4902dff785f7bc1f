"""What a port says of itself after an interruption: go on, open it again, or end the run."""

from types import SimpleNamespace
from typing import Any

import pytest

from cell.errors import CellError, error
from drivers.ur.feed import PLAYING, STOPPED
from drivers.ur.motion import UrMotion
from drivers.ur.script_end import Kicks, ScriptRecord


@pytest.fixture
def subject() -> Any:
    """A port whose script runs and was kicked last at 10 s; nothing of it is connected."""
    port = object.__new__(UrMotion)
    port.client = SimpleNamespace(  # type: ignore[assignment]
        kicks=Kicks(),
        killed=False,
        gave_up=False,
        withheld=False,
        ended=SimpleNamespace(is_set=lambda: False),
        death=lambda: error("CHILD_DIED", "killed by somebody"),
    )
    port._arm = SimpleNamespace(lost=None)  # type: ignore[assignment]
    port._closed = False
    port.script = ScriptRecord(port.client.kicks, 0.1)
    port.script.expect()
    for k in range(500, 506):
        port.client.kicks.note(k * 0.02)
    port.script.note(PLAYING, 9.0)
    return port


def ended(subject: Any, at: float) -> None:
    subject.script.note(PLAYING, at - 0.002)
    subject.script.note(STOPPED, at)


BY_THE_WATCHDOG, AT_THE_PENDANT = 10.2, 10.11


def test_a_script_that_our_watchdog_ended_may_be_opened_again(subject: Any) -> None:
    ended(subject, BY_THE_WATCHDOG)
    assert not subject.usable


@pytest.mark.parametrize("since", ["", "killed", "gave_up", "withheld", "_closed"])
def test_a_script_that_others_ended_is_not_opened_again_whatever_came_of_the_client(
    since: str, subject: Any
) -> None:
    ended(subject, AT_THE_PENDANT)
    if since:
        setattr(subject if since == "_closed" else subject.client, since, True)
    with pytest.raises(CellError, match="no program is running") as failure:
        _ = subject.usable
    assert failure.value.name == "ARM_SCRIPT_DIED"


def test_a_link_that_was_lost_after_others_ended_the_script_does_not_hide_it(subject: Any) -> None:
    ended(subject, AT_THE_PENDANT)
    subject._arm.lost = error("DEVICE_LOST", "arm")
    with pytest.raises(CellError, match="no program is running"):
        _ = subject.usable


def test_a_gap_in_the_states_that_hides_the_end_of_the_script_is_told(subject: Any) -> None:
    assert not subject.ended_unseen
    subject.script.note(PLAYING, BY_THE_WATCHDOG - 0.3)
    subject.script.note(STOPPED, BY_THE_WATCHDOG)
    assert not subject.usable
    assert subject.ended_unseen


def test_a_script_that_runs_is_used(subject: Any) -> None:
    assert subject.usable


def test_a_script_that_runs_without_kicks_is_not_used(subject: Any) -> None:
    subject.client.withheld = True
    assert not subject.usable


@pytest.mark.parametrize("how", ["killed", "gave_up"])
def test_a_client_that_ended_itself_or_was_ended_by_us_is_replaced(how: str, subject: Any) -> None:
    setattr(subject.client, how, True)
    assert not subject.usable
    ended(subject, BY_THE_WATCHDOG)
    assert not subject.usable


def test_a_client_that_somebody_killed_ends_the_run(subject: Any) -> None:
    subject.client.ended = SimpleNamespace(is_set=lambda: True)
    with pytest.raises(CellError, match="killed by somebody"):
        _ = subject.usable
