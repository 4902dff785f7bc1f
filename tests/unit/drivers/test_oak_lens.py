"""A lens that can move stays where the intrinsics hold; a rolling shutter has a time for each row."""

import pytest

from cell.devices import Frame, Intrinsics
from cell.errors import CellError
from drivers.oak.lens import LensWatch
from drivers.oak.shutter import row_time_s


def test_frames_on_the_lens_s_way_do_not_count_and_one_that_leaves_is_an_error() -> None:
    subject = LensWatch(135)
    assert [subject.usable(position) for position in (90, 120, 135, 135)] == [False, False, True, True]
    with pytest.raises(CellError, match="at 131 of 255, and it was at 135") as found:
        subject.usable(131)
    assert found.value.name == "CAMERA_LENS_MOVED"


def test_a_lens_stays_where_the_first_frame_has_it_or_tells_no_position() -> None:
    subject = LensWatch()
    assert subject.usable(None)
    assert subject.usable(128)
    with pytest.raises(CellError):
        subject.usable(127)


def test_a_point_is_exposed_with_the_row_on_which_it_lies() -> None:
    frame = Frame(
        1, 10.0, 0.004, Intrinsics(1280, 800, (800.0, 800.0, 640.0, 400.0)), None, "", row_time_s=2e-5
    )
    assert frame.t_of([0.1, 0.0, 1.0]) == pytest.approx(10.008)
    assert frame.t_of([0.1, 0.25, 1.0]) == pytest.approx(10.012)
    assert frame.t_of([0.1, -9.0, 1.0]) == 10.0
    assert frame.exposed_until == pytest.approx(10.018)


def test_rows_take_as_long_as_the_sensor_says() -> None:
    assert row_time_s("imx378", 1080) == pytest.approx(15.4e-6, rel=0.01)
    assert row_time_s("IMX214", 2160) == pytest.approx(0.033 / 2160)
    assert row_time_s("AR0234", 1200) == 0.0
    assert row_time_s("unheard of", 800) is None
