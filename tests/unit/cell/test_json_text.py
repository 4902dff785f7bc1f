"""JSON made in pieces is the text of the standard library, whatever stands in it."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.store.json_text import json_text

SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
)
KEYS = st.text() | st.integers() | st.booleans() | st.none()
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner) | st.tuples(inner, inner) | st.dictionaries(KEYS, inner),
    max_leaves=40,
)


@given(VALUES, st.booleans())
def test_the_text_is_that_of_the_standard_library(value: Any, ensure_ascii: bool) -> None:
    expected = json.dumps(value, allow_nan=False, ensure_ascii=ensure_ascii)
    assert json_text(value, ensure_ascii=ensure_ascii) == expected


def test_long_lists_are_put_together_without_a_seam() -> None:
    way = {
        "t": [0.001 * k for k in range(1701)],
        "xyz": [[k, 2.0 * k, -1.5] for k in range(999)],
        "n": [{}, []] * 201,
    }
    assert json_text([way] * 3) == json.dumps([way] * 3)


@pytest.mark.parametrize("value", [float("nan"), [[float("inf")]], {"a": {1, 2}}, {(1, 2): 3}, [object()]])
def test_what_json_cannot_hold_is_refused_as_there(value: Any) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        json_text(value)
    with pytest.raises(caught.type):
        json.dumps(value, allow_nan=False)
