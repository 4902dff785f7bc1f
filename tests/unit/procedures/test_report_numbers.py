"""Numbers in the report: units, signs, tolerance of junk, and the radius of 95 %."""

import numpy as np
import pytest

from procedures.report.html import el, text
from procedures.report.numbers import DASH, covariance, deg, dig, matrix4, mm, mms, number


@pytest.mark.parametrize(
    ("metres", "shown"),
    [(0.0123456, "12.346 mm"), (-0.0864, "−86.400 mm"), (2.34e-6, "0.0023 mm"), (0.0, "0.000 mm")],
)
def test_metres_are_shown_as_millimetres(metres: float, shown: str) -> None:
    assert mm(metres) == shown


def test_radians_are_shown_as_degrees() -> None:
    assert deg(np.pi / 6) == "30.0000°"


def test_zero_has_no_sign() -> None:
    assert mms([-1e-9]) == ["0.000"]


@pytest.mark.parametrize("junk", [None, "1", True, float("nan"), float("inf"), [1.0], {}])
def test_what_is_no_number_is_a_dash(junk: object) -> None:
    assert number(junk) is None
    assert mm(junk) == DASH


@pytest.mark.parametrize("junk", [None, [1.0] * 5, [0.0] * 5 + ["a"], "123456", {"x": 1}])
def test_what_is_no_pose_is_none(junk: object) -> None:
    assert matrix4(junk) is None


@pytest.mark.parametrize("junk", [None, [[1.0]], "x", [[None] * 6] * 6, [[1.0] * 6] * 5, [[1.0], [2.0, 3.0]]])
def test_what_is_no_covariance_is_none(junk: object) -> None:
    assert covariance(junk) is None


def test_digging_into_what_is_not_there_gives_none() -> None:
    assert dig({"a": {"b": 1}}, "a", "b") == 1
    assert dig({"a": 3}, "a", "b") is None
    assert dig(None, "a") is None


def test_plain_text_is_escaped_and_markup_is_not_escaped_twice() -> None:
    assert el("p", "a < b & ", el("b", "c")) == "<p>a &lt; b &amp; <b>c</b></p>"
    assert text('"') == "&quot;"
    assert el("p", id='"><script>') == '<p id="&quot;&gt;&lt;script&gt;"></p>'
