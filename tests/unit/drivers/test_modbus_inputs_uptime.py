"""A module's own count of time tells a restart, and a module that answers and repeats old values."""

import pytest

from cell.errors import CellError
from drivers.modbus_inputs.uptime import FROZEN_AFTER_S, LOOK_EVERY_S, UptimeWatch


@pytest.fixture
def subject() -> UptimeWatch:
    return UptimeWatch("beams")


def test_a_count_that_grows_says_nothing_however_slowly(subject: UptimeWatch) -> None:
    for k in range(20):
        assert subject.due(k * LOOK_EVERY_S)
        subject.take(k * LOOK_EVERY_S, 1000 + k // 4)
        assert not subject.due((k + 0.5) * LOOK_EVERY_S)


def test_a_count_that_falls_is_a_restart(subject: UptimeWatch) -> None:
    subject.take(0.0, 1000)
    with pytest.raises(CellError, match="from 1000 to 2") as caught:
        subject.take(1.0, 2)
    assert caught.value.name == "MODULE_REBOOTED"


def test_a_count_that_stands_still_is_a_module_that_repeats_old_values(subject: UptimeWatch) -> None:
    subject.take(0.0, 1000)
    subject.take(0.9 * FROZEN_AFTER_S, 1000)
    with pytest.raises(CellError, match="stands at 1000") as caught:
        subject.take(FROZEN_AFTER_S, 1000)
    assert caught.value.name == "MODULE_FROZEN"


def test_a_new_connection_begins_anew(subject: UptimeWatch) -> None:
    subject.take(0.0, 1000)
    subject.begin()
    subject.take(2.0 * FROZEN_AFTER_S, 3)
