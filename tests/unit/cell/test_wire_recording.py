"""A recording of the wire: what is written comes back, it stays within its limit, and damage is named."""

import asyncio
import struct
from pathlib import Path

import pytest

from cell.errors import CellError
from cell.wire_recording.layout import MAGIC, RECORD, Kind
from cell.wire_recording.reader import WireRecording, read_recording
from cell.wire_recording.tap import NO_TAP, recorded_by, tap
from cell.wire_recording.writer import WireRecorder


@pytest.fixture(autouse=True)
def _only_when_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread writes at the end alone, so that a test says when the disk gets what."""
    monkeypatch.setattr("cell.wire_recording.writer.WRITE_PERIOD_S", 60.0)


def record(folder: Path, limit: int = 1 << 20) -> WireRecording:
    """One connection with a question and an answer, one that stays open."""
    recorder = WireRecorder(folder, limit, now=lambda: 5.0)
    with recorded_by(recorder):
        first, second = tap("dashboard", "10.0.0.1:29999"), tap("rtde", "10.0.0.1:30004")
        first.sent(b"running\n", 6.0)
        second.received(b"\x00\x01", 6.5)
        first.received(b"Program running: false\n", 7.0)
        first.closed()
    recorder.close()
    return read_recording(folder)


def test_what_is_recorded_comes_back_by_connection(tmp_path: Path) -> None:
    subject = record(tmp_path / "new")
    assert [(c.protocol, c.peer, c.opened, c.closed) for c in subject.connections] == [
        ("dashboard", "10.0.0.1:29999", 5.0, 5.0),
        ("rtde", "10.0.0.1:30004", 5.0, None),
    ]
    asked, answered = subject.of("dashboard")[0].records
    assert (asked.t, asked.sent, asked.data) == (6.0, True, b"running\n")
    assert (answered.t, answered.sent, answered.data) == (7.0, False, b"Program running: false\n")
    assert subject.left_out == []


def test_the_bytes_on_the_disk_are_those_of_the_document(tmp_path: Path) -> None:
    """Written down by hand from docs/recordings.md, so that both cannot be wrong alike."""
    record(tmp_path)
    data = (tmp_path / "wire-000001.bin").read_bytes()
    assert data[:8] == b"CWWIRE1\n"
    kind, channel, t, length = struct.unpack_from("<BIdI", data, 8)
    assert (kind, channel, t) == (0, 0, 5.0)
    opened = 8 + 17 + length
    assert struct.unpack_from("<BIdI", data, opened)[:3] == (1, 1, 5.0)
    question = struct.pack("<BIdI", 3, 1, 6.0, 8) + b"running\n"
    answer = struct.pack("<BIdI", 2, 1, 7.0, 23) + b"Program running: false\n"
    assert question in data
    assert data.endswith(answer + struct.pack("<BIdI", 4, 1, 5.0, 0))


def test_without_a_recording_a_tap_does_nothing() -> None:
    assert tap("rtde", "10.0.0.1:30004") is NO_TAP


def test_tasks_that_are_started_inside_are_recorded(tmp_path: Path) -> None:
    async def device() -> None:
        tap("tracker", "tcp://10.0.0.2:5000").received(b"1 2 3\n")

    async def cell() -> None:
        with recorded_by(recorder):
            task = asyncio.create_task(device())
        await task

    recorder = WireRecorder(tmp_path, 1 << 20)
    asyncio.run(cell())
    recorder.close()
    assert read_recording(tmp_path).connections[0].records[0].data == b"1 2 3\n"


def test_it_stays_within_its_limit_and_says_what_went(tmp_path: Path) -> None:
    limit = 160_000
    recorder = WireRecorder(tmp_path, limit)
    with recorded_by(recorder):
        told = tap("rtde", "10.0.0.1:30004")
    for number in range(400):
        told.received(number.to_bytes(2) * 500)
        recorder._write()
    recorder.close()
    sizes = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert sizes <= limit
    subject = read_recording(tmp_path)
    assert "were dropped to keep to the limit" in subject.left_out[0]
    (connection,) = subject.connections  # told once more in each segment
    numbers = [int.from_bytes(one.data[:2]) for one in connection.records]
    assert numbers == list(range(numbers[0], 400))
    assert len(numbers) > 100


def test_recordings_of_one_folder_share_the_limit(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        recorder = WireRecorder(tmp_path / name, 64_000, bounded_with=tmp_path)
        told = recorder.channel("rtde", "10.0.0.1:30004")
        for _ in range(60):
            told.received(bytes(500))
            recorder._write()
        recorder.close()
    found = [path for path in tmp_path.rglob("wire-*.bin")]
    assert sum(path.stat().st_size for path in found) <= 64_000
    assert (tmp_path / "c" / "wire-000001.bin") in found
    assert not list((tmp_path / "a").iterdir())


def test_what_a_slow_disk_leaves_no_room_for_is_left_out_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cell.wire_recording.writer._MOST_WAITING", 1000)
    recorder = WireRecorder(tmp_path, 1 << 20)
    told = recorder.channel("rtde", "10.0.0.1:30004")
    for _ in range(5):
        told.received(bytes(600))
    recorder.close()
    subject = read_recording(tmp_path)
    assert len(subject.connections[0].records) == 2
    assert "1800 bytes" in subject.left_out[0]


def test_a_recording_is_not_written_over(tmp_path: Path) -> None:
    record(tmp_path)
    with pytest.raises(CellError, match="holds a recording already"):
        WireRecorder(tmp_path, 1 << 20)


def test_the_end_may_be_cut_off_as_of_a_power_failure(tmp_path: Path) -> None:
    record(tmp_path)
    path = tmp_path / "wire-000001.bin"
    path.write_bytes(path.read_bytes()[:-20])
    answer = read_recording(tmp_path).of("dashboard")[0]
    assert [one.data for one in answer.records] == [b"running\n"]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"no recording", "does not begin with"),
        (MAGIC + RECORD.pack(99, 0, 0.0, 0), "no record at byte 8"),
        (MAGIC + RECORD.pack(Kind.RECEIVED, 7, 0.0, 0), "channel 7, which is not open"),
        (MAGIC + RECORD.pack(Kind.HEADER, 0, 0.0, 2) + b"[]", "it has version None|no JSON object"),
        (MAGIC + RECORD.pack(Kind.HEADER, 0, 0.0, 13) + b'{"version":9}', "this program reads 1"),
    ],
)
def test_what_is_no_recording_is_named(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "wire-000001.bin").write_bytes(data)
    with pytest.raises(CellError, match=words):
        read_recording(tmp_path)


def test_an_empty_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(CellError, match="holds no recording"):
        read_recording(tmp_path)
