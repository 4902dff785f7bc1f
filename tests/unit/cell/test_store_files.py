"""Files, framed streams and journals survive torn ends, full disks and junk."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.clock import MonotonicClock
from cell.errors import CellError, InputError
from cell.packml import PackML
from cell.store.files import AppendFile, append_lines, plain, read_json, set_aside, to_json, write_atomic
from cell.store.framed import HEADER, FramedWriter, read_framed
from cell.store.journal import Journal, read_journal


def wall() -> float:
    return 1_700_000_000.0


def test_an_atomic_write_replaces_the_whole_file_and_leaves_no_temporary(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_atomic(path, '{"old": 1}')
    write_atomic(path, b'{"new": 2}')
    assert path.read_text() == '{"new": 2}'
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_full_disk_leaves_the_old_file_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    write_atomic(path, "old")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CellError, match="disk is full") as caught:
        write_atomic(path, "new")
    assert caught.value.name == "DISK_FULL"
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize(
    ("content", "name", "words"),
    [
        (None, "FILE_MISSING", "x.json"),
        (b'{"a": 1,\n "b": }', "FILE_UNREADABLE", "x.json:2: not JSON"),
        (b'{"a": NaN}', "FILE_UNREADABLE", "write null"),
        (b"\xff\xfe{}", "FILE_UNREADABLE", "not UTF-8"),
        (b"[" * 100_000, "FILE_UNREADABLE", "x.json"),
        (b'"' + b"a" * 200 + b'"', "FILE_UNREADABLE", "limit of 150"),
    ],
)
def test_a_bad_json_file_is_one_sentence(
    tmp_path: Path, content: bytes | None, name: str, words: str
) -> None:
    path = tmp_path / "x.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_json(path, max_bytes=150 if words == "limit of 150" else 2**20)
    assert caught.value.name == name
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_in_place_of_a_file_is_unreadable(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_json(tmp_path)
    assert caught.value.name == "FILE_UNREADABLE"


def test_json_carries_numpy_enums_and_paths_and_turns_nan_into_null() -> None:
    value = {
        "a": np.array([1.0, np.nan]),
        "n": np.int64(3),
        "s": PackML.IDLE,
        "p": Path("/x"),
        "i": float("inf"),
    }
    assert json.loads(to_json(value)) == {"a": [1.0, None], "n": 3, "s": 4, "p": "/x", "i": None}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ([1.0, float("nan"), -float("inf")], "[1.0, null, null]"),
        ([1, float("inf")], "[1, null]"),
        ([1, True, "a", None], '[1, true, "a", null]'),
        ([np.float64(1.5), 2.0], "[1.5, 2.0]"),
        ([[float("nan")], [np.int64(3)]], "[[null], [3]]"),
    ],
)
def test_a_list_is_plain_whatever_is_in_it(value: list[object], text: str) -> None:
    assert to_json(value) == text


def test_a_plain_list_is_not_the_one_that_was_given() -> None:
    value = [1.0, 2.0]
    assert plain(value) == value
    assert plain(value) is not value


def test_corrupt_files_are_kept_under_new_names(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    names = []
    for content in ("one", "two"):
        path.write_text(content)
        names.append(set_aside(path).name)
    assert names == ["ledger.corrupt-1", "ledger.corrupt-2"]
    assert (tmp_path / "ledger.corrupt-1").read_text() == "one"


def test_an_append_that_fails_half_way_is_cut_off_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    subject = AppendFile(tmp_path / "f")
    subject.append(b"first\n")
    write = os.write

    def half(handle: int, data: memoryview) -> int:
        if len(data) < 8:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(handle, data[:5])

    monkeypatch.setattr(os, "write", half)
    with pytest.raises(CellError) as caught:
        subject.append(b"second line\n")
    monkeypatch.undo()
    subject.append(b"third\n")
    subject.close()
    assert caught.value.name == "DISK_FULL"
    assert (tmp_path / "f").read_bytes() == b"first\nthird\n"


@given(st.lists(st.binary(max_size=40), max_size=8), st.integers(min_value=0, max_value=500))
def test_a_framed_file_cut_anywhere_gives_its_whole_frames(
    tmp_path_factory: pytest.TempPathFactory, frames: list[bytes], cut: int
) -> None:
    path = tmp_path_factory.mktemp("framed") / "s"
    with FramedWriter(path) as subject:
        for frame in frames:
            subject.append(frame)
    whole = path.read_bytes()
    assert read_framed(path) == (frames, True)
    path.write_bytes(whole[:cut])
    got, intact = read_framed(path)
    assert got == frames[: len(got)]
    ends = [len(HEADER)]
    for frame in frames:
        ends.append(ends[-1] + 8 + len(frame))
    assert intact == (min(cut, len(whole)) in ends)
    assert len(got) == sum(end <= cut for end in ends[1:])


def test_a_framed_file_is_continued_behind_its_last_whole_frame(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with FramedWriter(path) as subject:
        subject.append(b"one")
        subject.append(b"two")
    path.write_bytes(path.read_bytes()[:-1])
    with FramedWriter(path) as subject:
        subject.append(b"three")
    assert read_framed(path) == ([b"one", b"three"], True)


@pytest.mark.parametrize("damage", [b"\0" * 64, b"\x05\0\0\0\1\2\3\4hello", b"\xff" * 20])
def test_junk_behind_the_frames_is_seen(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "s"
    with FramedWriter(path) as subject:
        subject.append(b"one")
    path.write_bytes(path.read_bytes() + damage)
    assert read_framed(path) == ([b"one"], False)


def test_a_foreign_file_is_neither_read_nor_overwritten_as_framed(tmp_path: Path) -> None:
    path = tmp_path / "s"
    path.write_bytes(b"something else entirely")
    for attempt in (read_framed, FramedWriter):
        with pytest.raises(InputError) as caught:
            attempt(path)
        assert caught.value.name == "FILE_UNREADABLE"
    assert path.read_bytes() == b"something else entirely"


def test_frames_are_in_the_file_after_flush_and_not_before(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with FramedWriter(path) as subject:
        subject.append(b"one")
        assert read_framed(path) == ([], False)
        subject.flush()
        assert read_framed(path) == ([b"one"], True)


def test_a_journal_has_one_wall_time_and_numbered_lines(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    subject = Journal(path, MonotonicClock(), wall)
    subject.append("state", state="SEEK", why="start")
    subject.append("error", fsync=True, code=1001, residual=float("nan"))
    subject.close()
    header, *lines = read_journal(path)
    assert header["schema"] == "cellward.journal/1"
    assert header["wall"] == "2023-11-14T22:13:20.000+00:00"
    assert [(line["seq"], line["kind"]) for line in lines] == [(1, "state"), (2, "error")]
    assert lines[1]["residual"] is None
    assert not any("wall" in line for line in lines)


@pytest.mark.parametrize("torn", [b'{"seq": 77, "t"', b"\0\0\0\0", b'{"seq": 77}'])
def test_a_torn_last_line_is_left_out_and_cut_off_when_the_journal_goes_on(
    tmp_path: Path, torn: bytes
) -> None:
    path = tmp_path / "journal.jsonl"
    subject = Journal(path, MonotonicClock(), wall)
    subject.append("state", state="SEEK")
    subject.close()
    path.write_bytes(path.read_bytes() + torn)
    assert [line["seq"] for line in read_journal(path)] == [0, 1]
    subject = Journal(path, MonotonicClock(), wall)
    subject.append("state", terminal=True)
    subject.close()
    lines = read_journal(path)
    assert [(line["seq"], line["kind"]) for line in lines] == [
        (0, "header"), (1, "state"), (2, "header"), (3, "state"),
    ]  # fmt: skip
    assert torn not in path.read_bytes()


def test_a_damaged_line_in_the_middle_costs_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    subject = Journal(path, MonotonicClock(), wall)
    subject.append("state", state="A")
    subject.append("state", state="B")
    subject.close()
    path.write_bytes(path.read_bytes().replace(b'"state":', b'"state"\xff', 1).replace(b'"A"', b"A"))
    assert [line["seq"] for line in read_journal(path)] == [0, 2]


@pytest.mark.parametrize(("kind", "fields"), [("gossip", {}), ("state", {"seq": 9})])
def test_a_journal_refuses_unknown_kinds_and_reserved_fields(
    tmp_path: Path, kind: str, fields: dict[str, int]
) -> None:
    subject = Journal(tmp_path / "j", MonotonicClock(), wall)
    with pytest.raises(CellError) as caught:
        subject.append(kind, **fields)
    subject.close()
    assert caught.value.name == "INTERNAL"


def test_lines_are_appended_whole_and_a_disk_that_refuses_is_told_by_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lines.jsonl"
    append_lines(path, [{"a": 1}])
    append_lines(path, [{"b": 2}, {"c": 3}])
    assert path.read_text("utf-8") == '{"a": 1}\n{"b": 2}\n{"c": 3}\n'

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CellError) as caught:
        append_lines(path, [{"d": 4}])
    assert caught.value.name == "DISK_FULL"
