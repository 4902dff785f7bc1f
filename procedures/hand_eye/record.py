"""The raw data of a capture on disk: one line a finished pose, durable before the next move.

``poses.jsonl`` grows by one fsynced line a finished pose, so a kill at any moment loses none. Its other
lines say where each placement started and when it was complete, which is what taking up again needs.
``capture.json`` is the data set made of it; it is written when solving starts.
"""

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cell.devices import ArmState, Frame, Intrinsics, flange_poses
from cell.errors import error
from cell.poses import to_pose6
from cell.samples import Sample
from cell.store.files import append_lines, write_atomic

POSES_FILE = "poses.jsonl"
CAPTURE_FILE = "capture.json"
HEADER_SCHEMA = "cellward.cone-capture-poses/1"


class CaptureRecord:
    """Finished poses of one run. All methods block on the disk: call them in a thread."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.header: dict[str, Any] = {}
        self.observations: list[dict[str, Any]] = []
        self.placements: dict[int, dict[str, Any]] = {}  # group -> where and how the board was first seen
        self.complete: set[int] = set()

    @classmethod
    def read(cls, folder: Path) -> "CaptureRecord":
        """The finished poses of a run folder; a line torn by a kill is left out.

        ``FILE_UNREADABLE`` when a whole line is damaged.
        """
        record = cls(folder)
        path = folder / POSES_FILE
        if not path.exists():
            return record
        for number, line in enumerate(path.read_bytes().splitlines(keepends=True), 1):
            if not line.endswith(b"\n"):
                break
            try:
                record._take(json.loads(line))
            except (ValueError, KeyError, TypeError, AttributeError) as exc:
                raise error("FILE_UNREADABLE", f"{path}:{number}: no line of a capture's poses") from exc
        return record

    def begin(self, header: Mapping[str, Any], adopted: "CaptureRecord | None" = None) -> None:
        """Write the header, and take over the finished poses (with their images) of ``adopted``."""
        (self.folder / "images").mkdir(exist_ok=True)
        self._append({"kind": "header", "schema": HEADER_SCHEMA, **header})
        if adopted is None:
            return
        for group, start in adopted.placements.items():
            self._append({**start, "kind": "placement", "group": group})
        for observation in adopted.observations:
            for frame in observation["frames"]:
                for name in filter(None, (frame.get("image"), frame.get("depth"))):
                    with suppress(FileNotFoundError):  # removed by pruning; the corners are in the data
                        os.link(adopted.folder / name, self.folder / name)
            self.add_pose(observation)
        for group in adopted.complete:
            self.complete_placement(group)

    def begin_placement(
        self, group: int, start_q: Sequence[float], board: Mapping[str, Any], base: int | None = None
    ) -> None:
        """A placement starts with the arm at ``start_q`` (6,) rad and the board seen as ``board``.

        ``base`` is the number of its stand's place, where the job has bases.
        """
        where = {} if base is None else {"base": base}
        self._append(
            {"kind": "placement", "group": group, "start_q": list(start_q), "board": dict(board), **where}
        )

    def add_pose(self, observation: Mapping[str, Any]) -> None:
        """One finished pose; on disk when this returns."""
        self._append({"kind": "pose", **observation})

    def complete_placement(self, group: int) -> None:
        """No more poses of this placement will be taken."""
        self._append({"kind": "placement-complete", "group": group})

    def in_group(self, group: int) -> list[dict[str, Any]]:
        """The finished poses of one placement."""
        return [o for o in self.observations if o["group"] == group]

    def unfinished_placement(self) -> int | None:
        """The placement that was interrupted, if any."""
        return next((g for g in sorted(self.placements) if g not in self.complete), None)

    def next_group(self) -> int:
        return 1 + max(self.placements, default=-1)

    def next_index(self) -> int:
        return 1 + max((int(o["index"]) for o in self.observations), default=-1)

    def write_data_set(self) -> Path:
        """``capture.json`` of all finished poses."""
        data = {
            "schema": "cellward.capture/1",
            **self.header,
            "observations": [
                o
                if (base := self.placements.get(o["group"], {}).get("base")) is None
                else {**o, "base": base}
                for o in self.observations
            ],
        }
        path = self.folder / CAPTURE_FILE
        write_atomic(path, json.dumps(data, allow_nan=False))
        return path

    def _append(self, entry: Mapping[str, Any]) -> None:
        append_lines(self.folder / POSES_FILE, [entry])
        self._take(entry)

    def _take(self, entry: Mapping[str, Any]) -> None:
        rest = {k: v for k, v in entry.items() if k != "kind"}
        match entry["kind"]:
            case "header":
                self.header = {k: v for k, v in rest.items() if k != "schema"}
            case "placement":
                self.placements[rest.pop("group")] = rest
            case "pose":
                self.observations.append(rest)
            case "placement-complete":
                self.complete.add(rest["group"])


def camera_entry(intrinsics: Intrinsics, sigma: Mapping[str, float] | None = None) -> dict[str, Any]:
    """The ``camera`` table of a data set; ``sigma`` is how well it is known, where that is stated."""
    return {
        "width": intrinsics.width,
        "height": intrinsics.height,
        "K": list(intrinsics.K),
        "dist": list(intrinsics.dist),
    } | ({} if sigma is None else {"sigma": dict(sigma)})


def observation_entry(
    index: int,
    group: int,
    folder: Path,
    frames: Sequence[Frame],
    states: Sequence[Sample[ArmState]],
    points: int,
) -> dict[str, Any]:
    """One finished pose: mean flange pose over the exposures, and every frame's measured corners.

    The arm is at rest, so the mean over its samples only removes reading noise.
    """
    mean = flange_poses([s.value for s in states]).mean()
    return {
        "index": index,
        "group": group,
        **({"image": _relative(frames[0].colour_file, folder)} if frames[0].colour_file else {}),
        "T_base_flange": [float(v) for v in to_pose6(mean)],
        "q": [float(v) for v in np.mean([s.value.q for s in states], axis=0)],
        "t": frames[0].t_exposure,
        "frames": [_frame_entry(frame, folder, points) for frame in frames],
    }


def _frame_entry(frame: Frame, folder: Path, points: int) -> dict[str, Any]:
    corners: list[list[float] | None] = [None] * points
    if frame.board is not None:
        for i, uv in zip(frame.board.ids, frame.board.corners, strict=True):
            corners[int(i)] = [float(uv[0]), float(uv[1])]
    entry: dict[str, Any] = {"t": frame.t_exposure, "corners": corners}
    if frame.colour_file is not None:
        entry["image"] = _relative(frame.colour_file, folder)
    if frame.depth_file is not None:
        entry["depth"] = _relative(frame.depth_file, folder)
    return entry


def _relative(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()
