"""A slip of the encoder's wheel, told from where the items are seen."""

import numpy as np
import pytest

from calibration.belt.slip import SightedPlaces, SlipWatch

SIGMA = 1.3e-4
V, EACH_S = 0.15, 0.1
ITEMS = np.array([[-0.25 * k + 0.013 * (-1) ** k, 0.01 * (k % 3)] for k in range(40)])


def frame(
    k: int, ahead: float = 0.0, items: np.ndarray = ITEMS, view: tuple[float, float] = (-1.3, -0.1)
) -> SightedPlaces:
    """Frame ``k`` of a steady belt whose counts are ``ahead`` m ahead of it: what is in view."""
    t = EACH_S * k
    noise = SIGMA * np.random.default_rng([7, k]).standard_normal(items.shape)
    seen = (items[:, 0] + V * t >= view[0]) & (items[:, 0] + V * t <= view[1])
    return SightedPlaces(t, V * t + ahead, (items + noise - [ahead, 0.0])[seen], SIGMA)


@pytest.mark.parametrize("ahead", [0.005, -0.005, 0.04, -0.0025])
def test_a_slip_is_told_by_its_size_from_the_second_frame_after_it(ahead: float) -> None:
    watch = SlipWatch(0.03)
    assert all(watch.look(frame(k)) for k in range(20))
    assert watch.look(frame(20, ahead)) is None
    trust = watch.look(frame(21, ahead))
    assert trust is not None
    assert trust.slip is not None
    assert trust.since == trust.slip.t == pytest.approx(2.0)
    assert trust.slip.by == pytest.approx(-ahead, abs=5 * trust.slip.sigma)
    assert trust.slip.items >= 3
    assert trust.slip.sigma < SIGMA
    after = watch.look(frame(22, ahead))
    assert after is not None
    assert after.slip is None, "told once"


def test_a_frame_in_the_middle_of_a_slip_is_left_out() -> None:
    watch = SlipWatch(0.03)
    assert watch.look(frame(20))
    assert watch.look(frame(21, 0.003)) is None
    assert watch.look(frame(22, 0.008)) is None
    trust = watch.look(frame(23, 0.008))
    assert trust is not None
    assert trust.slip is not None
    assert trust.since == pytest.approx(2.2)
    assert trust.slip.by == pytest.approx(-0.008, abs=5 * trust.slip.sigma)


def test_one_bad_frame_is_no_slip() -> None:
    watch = SlipWatch(0.03)
    assert watch.look(frame(20))
    assert watch.look(frame(21, 0.006)) is None
    trust = watch.look(frame(22))
    assert trust is not None
    assert trust.slip is None
    assert trust.since > frame(21).t, "what was doubted is not used"


def test_one_item_that_somebody_moved_is_no_slip() -> None:
    watch = SlipWatch(0.03)
    moved = ITEMS + np.where(np.arange(len(ITEMS)) == 4, 0.006, 0.0)[:, None] * [1.0, 0.0]
    assert watch.look(frame(20))
    assert watch.look(frame(21, items=moved))


def test_items_like_eggs_in_a_row_do_not_make_a_slip_of_one_place() -> None:
    row = np.array([[-0.075 * k, 0.0] for k in range(80)])
    watch = SlipWatch(0.03)
    for k in range(60):
        assert watch.look(frame(k, items=row)), f"frame {k}"
    assert watch.look(frame(60, 0.005, row)) is None
    trust = watch.look(frame(61, 0.005, row))
    assert trust is not None
    assert trust.slip is not None
    assert trust.slip.by == pytest.approx(-0.005, abs=5 * trust.slip.sigma)


def test_a_single_item_tells_a_small_slip_and_a_far_one_is_another_item() -> None:
    for ahead, told in ((0.005, True), (0.06, False)):
        watch = SlipWatch(0.03)
        alone = ITEMS[4:5]
        assert watch.look(frame(20, items=alone))
        assert watch.look(frame(21, ahead, alone)) is None
        trust = watch.look(frame(22, ahead, alone))
        assert trust is not None
        assert (trust.slip is not None) is told


def test_a_scale_from_a_drawing_is_no_slip_not_even_after_two_seconds_without_pictures() -> None:
    watch = SlipWatch(0.03)
    for k in [*range(30), *range(50, 80)]:
        assert watch.look(frame(k, 0.008 * V * EACH_S * k)), f"frame {k}"


def test_counts_that_stand_while_items_move_are_astray_within_a_second_and_a_half() -> None:
    watch = SlipWatch(0.03)
    assert watch.look(frame(20))
    for k in range(21, 36):
        assert watch.look(frame(k, -V * EACH_S * (k - 20))) is None
        if watch.astray_s is not None:
            break
    assert watch.astray_s == pytest.approx(1.1)


def test_pictures_so_far_apart_that_all_items_have_left_the_view_between_them_are_not_astray() -> None:
    watch = SlipWatch(0.03)
    for k in range(30):
        assert watch.look(frame(k))
    for k in range(30, 500, 75):  # 7.5 s apart: 1.1 m, and the view is 1.2 m long
        assert watch.look(frame(k)), f"frame {k}"
    assert watch.astray_s is None


def test_a_bad_picture_before_a_long_gap_is_neither_used_nor_astray() -> None:
    watch = SlipWatch(0.03)
    for k in range(30):
        assert watch.look(frame(k))
    assert watch.look(frame(30, 0.006)) is None
    trust = watch.look(frame(140))
    assert watch.astray_s is None
    assert trust is not None
    assert trust.slip is None
    assert trust.since > frame(140).t, "what was doubted is not used"


def test_a_slip_between_two_pictures_a_second_apart_is_told_by_the_items_that_both_show() -> None:
    watch = SlipWatch(0.03)
    for k in range(0, 60, 10):
        assert watch.look(frame(k))
    assert watch.look(frame(60, 0.005)) is None
    trust = watch.look(frame(70, 0.005))
    assert trust is not None
    assert trust.slip is not None
    assert trust.slip.by == pytest.approx(-0.005, abs=5 * trust.slip.sigma)


def test_counts_that_stand_are_astray_by_four_pictures_a_second_apart() -> None:
    watch = SlipWatch(0.03)
    assert watch.look(frame(20))
    told = [watch.look(frame(k, -V * EACH_S * (k - 20))) or watch.astray_s for k in (30, 40, 50, 60)]
    assert told == [None, None, None, pytest.approx(3.0)]


def test_an_empty_belt_says_nothing() -> None:
    watch = SlipWatch(0.03)
    assert watch.look(frame(20))
    nothing = SightedPlaces(2.1, 0.315, np.zeros((0, 2)), SIGMA)
    assert watch.look(nothing)
    assert watch.look(frame(22))
