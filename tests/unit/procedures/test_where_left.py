"""Whether an arm was moved while nobody saw it: at rest it stays, else it gets as far as stopping takes."""

import numpy as np
import pytest

from cell.devices import ArmState
from cell.errors import CellError
from cell.samples import Sample
from cell.where_left import STAYED_RAD, STOPPING_S, WhereLeft

FASTEST_RAD_S = 0.5


@pytest.fixture
def subject() -> WhereLeft:
    return WhereLeft(FASTEST_RAD_S)


def at(q: float, qd: float = 0.0) -> Sample[ArmState]:
    zero = np.zeros(6)
    state = ArmState(np.full(6, q), np.full(6, qd), zero, zero, zero, 7, 1, True, 0, 0, 0.0)
    return Sample(state, 0.0, 0.001, 0)


def test_an_arm_at_rest_to_which_no_move_was_sent_stays(subject: WhereLeft) -> None:
    subject.leave(at(1.0))
    subject.found("arm", at(1.0 + 0.9 * STAYED_RAD))
    with pytest.raises(CellError, match="from where it was seen last") as failure:
        subject.found("arm", at(1.0 + 1.1 * STAYED_RAD))
    assert failure.value.name == "ARM_MOVED"


def test_an_arm_on_its_way_gets_as_far_as_stopping_takes_it(subject: WhereLeft) -> None:
    for far, fits in ((0.9, True), (1.1, False)):
        with pytest.raises(InterruptedError), subject.moving():
            raise InterruptedError
        subject.leave(at(1.0))
        here = at(1.0 + far * (STAYED_RAD + FASTEST_RAD_S * STOPPING_S))
        if fits:
            subject.found("arm", here)
        else:
            with pytest.raises(CellError):
                subject.found("arm", here)


def test_small_movements_over_a_row_of_interruptions_add_up(subject: WhereLeft) -> None:
    for k in range(2):
        subject.leave(at(1.0 + 0.4 * k * STAYED_RAD))
        subject.found("arm", at(1.0 + 0.4 * (k + 1) * STAYED_RAD))
    subject.leave(at(1.0 + 0.8 * STAYED_RAD))
    with pytest.raises(CellError):
        subject.found("arm", at(1.0 + 1.2 * STAYED_RAD))


def test_a_move_that_was_interrupted_twice_is_measured_from_where_it_was_left_first(
    subject: WhereLeft,
) -> None:
    reach = STAYED_RAD + FASTEST_RAD_S * STOPPING_S
    with pytest.raises(InterruptedError), subject.moving():
        raise InterruptedError
    subject.leave(at(1.0))
    subject.leave(at(1.0 + 0.7 * reach))  # silent again before it was found
    with pytest.raises(CellError):
        subject.found("arm", at(1.0 + 1.4 * reach))


def test_a_move_that_ended_leaves_an_arm_at_rest(subject: WhereLeft) -> None:
    subject.leave(at(1.0))
    with subject.moving():
        pass
    subject.leave(at(2.0))
    subject.found("arm", at(2.0))
    with pytest.raises(CellError):
        subject.found("arm", at(2.01))
