"""Passes of a reference as short texts."""

import base64
import json
import zlib
from typing import Any

import pytest

from cell.errors import CellError
from procedures.laser.packed import packed, same_passes, unpacked

PASS = {"beam": "xs", "dir": -1, "pose_t": [1.25, 1.2520000000000002], "poll_v": [0, 1], "notes": {"a": 0}}


def _text(content: bytes, level: int = 6) -> str:
    return base64.b64encode(zlib.compress(content, level)).decode()


def test_a_pass_comes_back_to_the_last_bit() -> None:
    assert unpacked(packed(PASS)) == PASS


def test_a_pass_of_an_earlier_version_is_taken_as_it_is() -> None:
    assert unpacked(PASS) == PASS


@pytest.mark.parametrize(
    "entry",
    [
        "",
        "no base64!",
        _text(b"no JSON"),
        packed(PASS)[:40],
        _text(b"[]"),
        _text(b'{"z": NaN}'),
        _text(b"[" * 100_000),
        5,
        None,
    ],
)
def test_another_entry_is_refused_in_a_sentence(entry: Any) -> None:
    with pytest.raises(CellError, match="a pass of a laser reference") as raised:
        unpacked(entry)
    assert raised.value.name == "RESULT_INVALID"


def test_a_text_that_grows_beyond_any_pass_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.laser.packed.MOST_BYTES", 1000)
    with pytest.raises(CellError, match="longer than 1000 bytes"):
        unpacked(packed({"z": "a" * 2000}))


def test_passes_are_the_same_however_they_were_compressed_or_not_at_all() -> None:
    other = _text(json.dumps(PASS).encode(), 1)
    assert other != packed(PASS)
    assert same_passes([other, PASS], [packed(PASS), packed(PASS)])
    assert not same_passes([packed(PASS)], [packed({**PASS, "dir": 1})])
    assert not same_passes([packed(PASS)], [])
