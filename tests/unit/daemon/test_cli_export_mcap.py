"""``cellward export RUN --mcap``: what Foxglove opens of a run, read back with mcap's own reader."""

import base64
import json
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from cell.clock import MonotonicClock
from cell.poses import from_pose6
from cell.store.framed import FramedWriter
from cell.store.runs import RunFolder
from procedures.belt.record import BELIEF, COUNT, STEP
from tests.kit.cli_harness import CellOnDisk, CommandLine

PICTURE = b"\x89PNG\r\n\x1a\n" + bytes(range(64))
POSE = [-0.4, 0.1, 0.6, 2.1, 2.0, 0.3]
WAY = {
    "beam": "xs",
    "dir": 1,
    "z": 0.4,
    "used": True,
    "why": None,
    "pose_t": [10.0, 10.02],
    "pose_xyz": [[0.1, 0.2, 0.4], [0.1, 0.21, 0.4]],
    "poll_t": [10.0, 10.005, 10.01],
    "poll_v": [0, 1, 1],
    "poll_n": [4, 5, 5],
}
TAKEN = {
    "kind": "pose",
    "index": 0,
    "t": 11.5,
    "q": [0.1, -1.5, 1.5, -1.3, -1.6, 0.1],
    "T_base_flange": POSE,
    "frames": [{"t": 11.503, "corners": [[1.0, 2.0]], "image": "images/p0-0.png"}],
}


@pytest.fixture
def cell(tmp_path: Path) -> CellOnDisk:
    return CellOnDisk(tmp_path)


@pytest.fixture
def run(cell: CellOnDisk) -> RunFolder:
    """A run with a line of every kind that run folders have."""
    folder = RunFolder.create(cell.state / "runs", "cone-capture", 7, {}, MonotonicClock())
    folder.note("state", state="measure", why="begins")
    folder.note("error", code=3001, text="The arm made a protective stop")
    (folder.path / "images").mkdir()
    (folder.path / "images" / "p0-0.png").write_bytes(PICTURE)
    for name, rows in (
        ("passes", [WAY]),
        ("counts", [[12.0, 435, 60450], [12.005, 442, 60457]]),
        ("poses", [{"kind": "header", "schema": "x"}, TAKEN]),
        ("signatures", [{"t": 1.0, "who": "anna"}]),
    ):
        text = "".join(json.dumps(row) + "\n" for row in rows)
        torn = '{"kind": "po' if name == "poses" else ""
        (folder.path / f"{name}.jsonl").write_text(text + torn, "utf-8")
    folder.finish({"outcome": "complete", "packml": "COMPLETE", "verdict": "pass", "error": None})
    return folder


def read(file: Path) -> dict[str, list[tuple[int, str, Any]]]:
    """Topic by topic: log time in ns, schema, content."""
    found: dict[str, list[tuple[int, str, Any]]] = {}
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert message.publish_time == message.log_time
            entry = (message.log_time, schema.name, json.loads(message.data))
            found.setdefault(channel.topic, []).append(entry)
    return found


def test_every_stream_of_the_run_is_in_the_file_with_its_stamps_and_values(
    subject: CommandLine, run: RunFolder, tmp_path: Path
) -> None:
    done = subject("export", "7", "--mcap", tmp_path / "run.mcap")
    assert done.code == 0, done.err
    found = read(tmp_path / "run.mcap")
    header, *lines = run.read_journal()
    epoch_ns = round(datetime.fromisoformat(header["wall"]).timestamp() * 1e3) * 10**6

    def ns(t: float) -> int:
        return epoch_ns + round((t - header["t"]) * 1e9)

    assert {topic: len(messages) for topic, messages in found.items()} == {
        "/journal": len(lines),
        "/log": len(lines),
        "/passes": 1,
        "/passes/xs": 3,
        "/passes/tool_point": 2,
        "/counts": 2,
        "/poses": 1,
        "/arm/joints": 1,
        "/arm/flange": 1,
        "/tf": 1,
        "/camera/colour": 1,
    }
    assert [(stamp, content) for stamp, _, content in found["/journal"]] == [(ns(x["t"]), x) for x in lines]
    assert [content["level"] for *_, content in found["/log"]] == [
        4 if x["kind"] == "error" else 2 for x in lines
    ]
    assert found["/passes"] == [(ns(10.0), "cellward.Record", WAY)]
    polls = [(stamp, poll["level"], poll["changes"]) for stamp, _, poll in found["/passes/xs"]]
    assert polls == [(ns(10.0), False, 4), (ns(10.005), True, 5), (ns(10.01), True, 5)]
    points = [(stamp, one["point_m"]) for stamp, _, one in found["/passes/tool_point"]]
    assert points == list(zip(map(ns, WAY["pose_t"]), WAY["pose_xyz"], strict=True))  # type: ignore[call-overload]
    counts = [(stamp, one["count"], one["raw"]) for stamp, _, one in found["/counts"]]
    assert counts == [(ns(12.0), 435, 60450), (ns(12.005), 442, 60457)]
    assert found["/arm/joints"] == [(ns(11.5), "cellward.ArmJoints", {"q_rad": TAKEN["q"]})]
    stamp, schema, picture = found["/camera/colour"][0]
    assert (stamp, schema, picture["format"]) == (ns(11.503), "foxglove.CompressedImage", "png")
    assert base64.b64decode(picture["data"]) == PICTURE
    assert picture["timestamp"] == {"sec": stamp // 10**9, "nsec": stamp % 10**9}


def test_the_flange_is_where_the_run_says_in_the_frames_of_foxglove(
    subject: CommandLine, run: RunFolder, tmp_path: Path
) -> None:
    assert subject("export", "7", "--mcap", tmp_path / "run.mcap").code == 0
    found = read(tmp_path / "run.mcap")
    ((_, schema, transform),) = found["/tf"]
    assert (schema, transform["parent_frame_id"], transform["child_frame_id"]) == (
        "foxglove.FrameTransform",
        "base",
        "flange",
    )
    at = from_pose6(POSE)
    assert [transform["translation"][axis] for axis in "xyz"] == POSE[:3]
    assert [transform["rotation"][axis] for axis in "xyzw"] == pytest.approx(at.rotation.as_quat().tolist())
    ((_, schema, pose),) = found["/arm/flange"]
    assert (schema, pose["frame_id"]) == ("foxglove.PoseInFrame", "base")
    assert pose["pose"] == {"position": transform["translation"], "orientation": transform["rotation"]}


def test_what_a_run_of_picking_keeps_is_in_the_file(
    subject: CommandLine, run: RunFolder, tmp_path: Path
) -> None:
    step = (13.0, [0.1, 0.2, 0.3, 0.5], [0.01, 0.02, 0.03, 0.0], 0.15, 4)
    for name, payload in (
        ("counts", np.array([(13.0, 5), (13.005, 6)], COUNT).tobytes()),
        ("steps", np.array([step], STEP).tobytes()),
        ("belief", np.array([(13.0, 1.0, 0.1, 1.1, 0.11)], BELIEF).tobytes()),
        ("sightings", b'{"t": 12.9, "items": [[4, 0.1, 0.2, 0.3, 0.5]]}'),
    ):
        with FramedWriter(run.path / f"{name}.framed") as file:
            file.append(payload)
    (run.path / "counts.jsonl").unlink()
    assert subject("export", "7", "--mcap", tmp_path / "run.mcap").code == 0
    found = read(tmp_path / "run.mcap")
    first, second = found["/counts"]
    assert (first[2], second[2], second[0] - first[0]) == ({"count": 5}, {"count": 6}, 5_000_000)
    ((at, _, taken),) = found["/steps"]
    assert at == first[0]
    assert (taken["position_m"], taken["yaw_rad"], taken["item"]) == ([0.1, 0.2, 0.3], 0.5, 4)
    assert (taken["velocity_m_s"], taken["belt_m_s"]) == ([0.01, 0.02, 0.03], 0.15)
    assert found["/belief"][0][2] == {"raw_m": 1.0, "raw_m_s": 0.1, "travel_m": 1.1, "speed_m_s": 0.11}
    assert found["/sightings"][0][2]["items"] == [[4, 0.1, 0.2, 0.3, 0.5]]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--mcap", "x.mcap"), "--mcap is of one run: give its number"),
        (("T_flange_tool", "--mcap", "x.mcap"), "'T_flange_tool' is no number of a run"),
        (("8", "--mcap", "x.mcap"), "run 8"),
        (("7", "--mcap", "none/x.mcap"), "none does not exist"),
        (("7", "--mcap", "x.mcap", "-f", "json"), "leave out -f, -o and --parquet"),
    ],
)
def test_what_makes_no_sense_is_refused(
    subject: CommandLine, run: RunFolder, words: tuple[str, ...], told: str
) -> None:
    refused = subject("export", *words)
    assert refused.code != 0
    assert told in refused.err


def test_without_mcap_it_says_what_to_install(
    subject: CommandLine, run: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    refused = subject("export", "7", "--mcap", tmp_path / "run.mcap")
    assert "install the extra cellward[mcap]" in refused.err
