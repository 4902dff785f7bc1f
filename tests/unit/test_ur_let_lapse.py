"""Whose end of our script was it: our own watchdog's, so that it may be opened again, or somebody else's?"""

from types import SimpleNamespace
from typing import Any

import pytest

from cell.errors import CellError, error
from drivers.ur.motion import UrMotion


@pytest.fixture
def subject() -> Any:
    """A port whose script was seen to end at 10 s; nothing of it is connected."""
    port = object.__new__(UrMotion)
    port.client = SimpleNamespace(  # type: ignore[assignment]
        killed=False,
        gave_up=False,
        withheld=False,
        lapse=(0.0, 0.0),
        ended=SimpleNamespace(is_set=lambda: False),
        death=lambda: error("CHILD_DIED", "killed by somebody"),
    )
    port._arm = SimpleNamespace(lost=None)  # type: ignore[assignment]
    port._closed, port.owns_program, port._program_ended = False, False, 10.0
    return port


def test_a_script_that_ended_within_a_lapse_of_ours_may_be_opened_again(subject: Any) -> None:
    subject.client.lapse = (9.9, 10.05)
    assert not subject.usable


@pytest.mark.parametrize("lapse", [(0.0, 0.0), (5.0, 5.2), (10.001, 10.2)], ids=["none", "earlier", "later"])
def test_a_script_that_others_ended_is_not_opened_again(lapse: tuple[float, float], subject: Any) -> None:
    subject.client.lapse = lapse
    with pytest.raises(CellError, match="no program is running") as failure:
        _ = subject.usable
    assert failure.value.name == "ARM_SCRIPT_DIED"


def test_a_script_that_runs_is_used(subject: Any) -> None:
    subject.owns_program = True
    assert subject.usable


def test_a_client_that_ended_itself_or_was_ended_by_us_is_replaced(subject: Any) -> None:
    subject.client.gave_up = True
    assert not subject.usable
    subject.client.gave_up, subject.client.killed = False, True
    assert not subject.usable


def test_a_client_that_somebody_killed_ends_the_run(subject: Any) -> None:
    subject.client.ended = SimpleNamespace(is_set=lambda: True)
    with pytest.raises(CellError, match="killed by somebody"):
        _ = subject.usable
