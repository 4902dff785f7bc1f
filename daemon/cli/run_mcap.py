"""A run as one MCAP file, which Foxglove opens: its journal, poses, ways through beams, counts and pictures.

Every value stands as the run's folder has it, in SI. Stamps are nanoseconds since 1970: the monotonic time of
the run, moved by the wall time in the header of its journal. The schemas ``foxglove.*`` are those of the list
that Foxglove publishes (JSON), as far as they have what a run has.
"""

import base64
import io
import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.poses import from_pose6
from cell.store.files import contents, write_atomic
from cell.store.fingerprint import SIGNATURES_FILE
from cell.store.framed import read_framed
from cell.store.runs import JOURNAL_FILE, RunFolder
from cell.version import software
from daemon.words.journal_text import what
from procedures.belt.record import (
    BELIEF,
    BELIEF_FILE,
    COUNT,
    COUNTS_FILE,
    SIGHTINGS_FILE,
    STEP,
    STEPS_FILE,
    read_rows,
)

INFO, WARNING, ERROR = 2, 3, 4  # foxglove.Log
TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
NUMBER, TEXT, NUMBERS = {"type": "number"}, {"type": "string"}, {"type": "array", "items": {"type": "number"}}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


XYZ = _object(x=NUMBER, y=NUMBER, z=NUMBER)
XYZW = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
SCHEMAS: Mapping[str, Mapping[str, Any]] = {
    "foxglove.Log": _object(
        timestamp=TIME,
        level={"type": "integer"},
        message=TEXT,
        name=TEXT,
        file=TEXT,
        line={"type": "integer"},
    ),
    "foxglove.FrameTransform": _object(
        timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=XYZ, rotation=XYZW
    ),
    "foxglove.PoseInFrame": _object(
        timestamp=TIME, frame_id=TEXT, pose=_object(position=XYZ, orientation=XYZW)
    ),
    "foxglove.CompressedImage": _object(
        timestamp=TIME, frame_id=TEXT, data={**TEXT, "contentEncoding": "base64"}, format=TEXT
    ),
    "cellward.ArmJoints": _object(q_rad=NUMBERS),
    "cellward.ToolPoint": _object(point_m=NUMBERS, beam=TEXT, way={"type": "integer"}),
    "cellward.BeamPoll": _object(
        level={"type": "boolean"}, changes={"type": "integer"}, way={"type": "integer"}
    ),
    "cellward.EncoderCount": _object(count={"type": "integer"}, raw={"type": "integer"}),
    "cellward.PickingStep": _object(
        position_m=NUMBERS,
        yaw_rad=NUMBER,
        velocity_m_s=NUMBERS,
        yaw_rad_s=NUMBER,
        belt_m_s=NUMBER,
        item=NUMBER,
    ),
    "cellward.BeltBelief": _object(raw_m=NUMBER, raw_m_s=NUMBER, travel_m=NUMBER, speed_m_s=NUMBER),
    "cellward.Record": {"type": "object"},
}

Message = tuple[str, str, float, Mapping[str, Any]]  # topic, schema, monotonic s, content


def write_mcap(folder: RunFolder, file: Path) -> dict[str, int]:
    """Write ``folder`` as ``file``; how many messages each topic has. ``ARGUMENT_INVALID`` without mcap,
    ``FILE_UNREADABLE`` for a run without a journal, which has no wall time."""
    try:
        from mcap.writer import Writer
    except ImportError:
        raise error("ARGUMENT_INVALID", "--mcap needs mcap: install the extra cellward[mcap]") from None
    content, channels, counts = io.BytesIO(), dict[str, int](), dict[str, int]()
    writer = Writer(content)
    writer.start(library=software())
    schemas: dict[str, int] = {}
    for topic, schema, stamp_ns, message in sorted(stamped(folder), key=lambda one: one[2]):
        if schema not in schemas:
            data = json.dumps({"title": schema, **SCHEMAS[schema]}).encode()
            schemas[schema] = writer.register_schema(schema, "jsonschema", data)
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "json", schemas[schema])
        data = json.dumps(message, allow_nan=False).encode()
        counts[topic] = counts.get(topic, 0) + 1
        writer.add_message(channels[topic], stamp_ns, data, stamp_ns, counts[topic])
    about = {"run_id": str(folder.run_id), "job": folder.job, "started": str(folder.info.get("started"))}
    writer.add_metadata("cellward.run", about)
    writer.finish()  # type: ignore[no-untyped-call]
    write_atomic(file, content.getvalue())
    return counts


def stamped(folder: RunFolder) -> Iterator[tuple[str, str, int, Mapping[str, Any]]]:
    """Every message of the run: topic, schema, ns since 1970, content."""
    journal = folder.read_journal()
    headers = [line for line in journal if line["kind"] == "header"]
    if not headers:
        raise error("FILE_UNREADABLE", f"{folder.path / JOURNAL_FILE}: has no header, so no wall time")
    header = headers[0]
    for line in journal:
        if line["kind"] == "header":
            header = line  # opened again, perhaps by a process with another origin of time
            continue
        stamp = _wall_ns(header, line["t"])
        yield "/journal", "cellward.Record", stamp, line
        yield "/log", "foxglove.Log", stamp, _log(line, stamp, folder)
    for topic, schema, t, content in _measured(folder.path):
        stamp = _wall_ns(headers[0], t)
        timed = {"timestamp": _time(stamp), **content} if schema.startswith("foxglove.") else content
        yield topic, schema, stamp, timed


def _measured(path: Path) -> Iterator[Message]:
    yield from _picking(path)
    for file in sorted(path.rglob("*.jsonl")):
        if file.name in (JOURNAL_FILE, SIGNATURES_FILE):
            continue
        topic = "/" + "/".join(file.relative_to(path).with_suffix("").parts)
        for way, row in enumerate(_rows(file)):
            if isinstance(row, list):  # of an encoder: stamp, count, as it was sent
                yield topic, "cellward.EncoderCount", row[0], {"count": row[1], "raw": row[2]}
            elif "poll_t" in row:
                yield from _way(topic, way, row)
            elif isinstance(row.get("t"), int | float):
                yield topic, "cellward.Record", row["t"], row
                yield from _pose(path, row)


def _picking(path: Path) -> Iterator[Message]:
    """The framed files of a run that picks from a belt."""
    for t, count in _framed(path / COUNTS_FILE, COUNT):
        yield "/counts", "cellward.EncoderCount", t, {"count": count}
    for t, p, v, belt_m_s, item in _framed(path / STEPS_FILE, STEP):
        p, v = ([float(x) for x in row] for row in (p, v))
        where = {"position_m": p[:3], "yaw_rad": p[3], "velocity_m_s": v[:3], "yaw_rad_s": v[3]}
        yield "/steps", "cellward.PickingStep", t, {**where, "belt_m_s": belt_m_s, "item": item}
    for t, *belief in _framed(path / BELIEF_FILE, BELIEF):
        yield "/belief", "cellward.BeltBelief", t, dict(zip((BELIEF.names or ())[1:], belief, strict=True))
    for line in read_framed(path / SIGHTINGS_FILE)[0] if (path / SIGHTINGS_FILE).exists() else ():
        seen = json.loads(line)
        yield "/sightings", "cellward.Record", seen["t"], seen


def _framed(file: Path, kind: Any) -> list[Any]:
    return list(read_rows(file, kind).tolist()) if file.exists() else []


def _way(topic: str, way: int, row: Mapping[str, Any]) -> Iterator[Message]:
    """A way of the tool through one beam: the record, its polls, and where the tool's point was."""
    beam = str(row["beam"])
    yield topic, "cellward.Record", row["poll_t"][0], row
    counted = row.get("poll_n") or [0] * len(row["poll_t"])
    for t, level, changes in zip(row["poll_t"], row["poll_v"], counted, strict=True):
        yield (
            f"{topic}/{beam}",
            "cellward.BeamPoll",
            t,
            {"level": bool(level), "changes": changes, "way": way},
        )
    for t, point in zip(row["pose_t"], row["pose_xyz"], strict=True):
        yield f"{topic}/tool_point", "cellward.ToolPoint", t, {"point_m": point, "beam": beam, "way": way}


def _pose(folder: Path, row: Mapping[str, Any]) -> Iterator[Message]:
    """Of a capture: the arm's joints, the flange in the base, and the pictures that were kept."""
    if "q" in row:
        yield "/arm/joints", "cellward.ArmJoints", row["t"], {"q_rad": row["q"]}
    if (pose6 := row.get("T_base_flange")) is not None:
        at = from_pose6(pose6)
        x, y, z = (float(v) for v in at.translation)
        quaternion = dict(zip("xyzw", (float(v) for v in at.rotation.as_quat()), strict=True))
        where = {"x": x, "y": y, "z": z}
        frames = {"parent_frame_id": "base", "child_frame_id": "flange"}
        yield (
            "/tf",
            "foxglove.FrameTransform",
            row["t"],
            {**frames, "translation": where, "rotation": quaternion},
        )
        pose = {"position": where, "orientation": quaternion}
        yield "/arm/flange", "foxglove.PoseInFrame", row["t"], {"frame_id": "base", "pose": pose}
    for frame in row.get("frames", ()):
        for key, topic in (("image", "/camera/colour"), ("depth", "/camera/depth")):
            name = frame.get(key)
            if name and (picture := folder / name).is_file():  # pruning removes pictures
                text = base64.b64encode(contents(picture)).decode("ascii")
                shown = {"frame_id": "camera", "data": text, "format": picture.suffix.removeprefix(".")}
                yield topic, "foxglove.CompressedImage", frame["t"], shown


def _log(line: Mapping[str, Any], stamp_ns: int, folder: RunFolder) -> dict[str, Any]:
    level = ERROR if line["kind"] == "error" else WARNING if line.get("error") else INFO
    message, number = what(line), int(line["seq"])
    where = {"name": line["kind"], "file": f"{folder.path.name}/{JOURNAL_FILE}", "line": number}
    return {"timestamp": _time(stamp_ns), "level": level, "message": message, **where}


def _rows(file: Path) -> Iterator[Any]:
    """The whole lines; one torn by a kill is left out. ``FILE_UNREADABLE``."""
    for number, line in enumerate(contents(file).splitlines(keepends=True), 1):
        if not line.endswith(b"\n"):
            return
        try:
            yield json.loads(line)
        except ValueError:
            raise error("FILE_UNREADABLE", f"{file}:{number}: no JSON") from None


def _wall_ns(header: Mapping[str, Any], t: float) -> int:
    wall = datetime.fromisoformat(header["wall"])
    whole = int(wall.timestamp()) * 10**9 + wall.microsecond * 1000
    since_s: float = t - header["t"]
    return whole + round(since_s * 1e9)


def _time(stamp_ns: int) -> dict[str, int]:
    return {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}
