"""Passes of a reference as short texts."""

import pytest

from cell.errors import CellError
from procedures.laser.packed import packed, unpacked

PASS = {"beam": "xs", "dir": -1, "pose_t": [1.25, 1.2520000000000002], "poll_v": [0, 1], "notes": {"a": 0}}


def test_a_pass_comes_back_to_the_last_bit() -> None:
    assert unpacked(packed(PASS)) == PASS


def test_a_pass_of_an_earlier_version_is_taken_as_it_is() -> None:
    assert unpacked(PASS) == PASS


@pytest.mark.parametrize("text", ["", "no base64!", "bm8gemxpYg==", packed(PASS)[:40], "eJyLjgUAARUAuQ=="])
def test_another_text_is_refused_in_a_sentence(text: str) -> None:
    with pytest.raises(CellError, match="a pass of a laser reference") as raised:
        unpacked(text)
    assert raised.value.name == "RESULT_INVALID"
