"""What the height search takes of the tool from the two ways well below its end."""

import numpy as np
import pytest

from calibration.tool_frame.glimpse import Glimpse, glimpse
from procedures.laser.sought_height import Crossed, centre_of, chord_of, clear_of, span_of

SLIDE = 1.25e-4  # of each edge, with polls as they usually come


def way(first: float, last: float, half: tuple[float, float] = (SLIDE, SLIDE)) -> Crossed:
    return Crossed(np.array([first, last]), np.array(half))


def test_the_chord_is_what_both_ways_allow() -> None:
    chord, off = chord_of([way(0.0101, 0.0170), way(0.0100, 0.0171)])
    assert chord == pytest.approx(0.0070)
    assert off == pytest.approx(2.0 * SLIDE - 1e-4)


def test_a_late_poll_does_not_make_the_tool_wider() -> None:
    late = way(0.0100, 0.0178, (SLIDE, 1e-3))  # the light came back before the poll at 18.8 mm
    chord, off = chord_of([late, way(0.0100, 0.0170)])
    assert abs(chord - 0.0070) <= off <= 2.0 * SLIDE + 1e-12
    assert centre_of([late, way(0.0100, 0.0170)])[0] == pytest.approx(0.0135, abs=3e-5)
    assert span_of([late, way(0.0100, 0.0170)]) == pytest.approx(0.0078)


def test_two_late_ways_leave_the_chord_open_by_as_much() -> None:
    chord, off = chord_of([way(0.0100, 0.0178, (SLIDE, 1e-3)), way(0.0094, 0.0170, (8e-4, SLIDE))])
    assert abs(chord - 0.0070) <= off
    assert off > 7e-4


def test_ways_that_differ_by_what_the_arm_scatters_leave_the_chord_between_them() -> None:
    chord, off = chord_of([way(0.0100, 0.0170, (1e-5, 1e-5)), way(0.0100, 0.01706, (1e-5, 1e-5))])
    assert chord == pytest.approx(0.00703)
    assert off == pytest.approx(1e-5)


def test_a_delay_that_is_not_known_leaves_the_middle_as_open_as_it_is() -> None:
    """Of 6 ms at 50 mm/s: the way out shows everything 0.3 mm late, the way back as much early."""
    middle, apart = centre_of([way(0.0103, 0.0173), way(0.0097, 0.0167)])
    assert (middle, apart) == pytest.approx((0.0135, 6e-4))


def passed_by(height: float, slide: float, begin: float = 0.0) -> Glimpse:
    """A way with a poll each ``slide`` (m), of which none saw the beam broken."""
    places = np.arange(begin, 0.03, slide)
    return glimpse(height, 0, places, np.zeros(len(places), dtype=bool), 0.0135, 3e-4)


def test_ways_whose_polls_could_see_a_tool_say_that_it_was_clear() -> None:
    seen = [passed_by(height, 0.00075) for height in (-0.005, -0.005, -0.010, -0.010)]
    assert clear_of(-0.015, seen, 0.007, 0.005) == -0.010


def test_ways_whose_polls_may_have_missed_the_tool_do_not() -> None:
    """At 0.3 m/s with polls each 20 ms both ways now and then miss a tool that is half a millimetre down."""
    quick = [passed_by(-0.010, 0.006, 0.0), passed_by(-0.010, 0.006, 0.003)]
    slow = [passed_by(-0.005, 0.00075), passed_by(-0.005, 0.00075)]
    assert clear_of(-0.015, quick + slow, 0.007, 0.005) == -0.005
    assert clear_of(-0.015, quick, 0.007, 0.005) == pytest.approx(-0.005), "a step above"
    assert clear_of(-0.015, [], 0.007, 0.005) == pytest.approx(-0.010)
