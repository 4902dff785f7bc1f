"""What a run of picking saw and did, on disk: framed files while it runs, and a data set at its end.

``counts.framed`` has rows of :data:`COUNT`, ``steps.framed`` rows of :data:`STEP` and ``belief.framed`` rows
of :data:`BELIEF`, all of a tenth of a second in one frame; ``sightings.framed`` has one JSON object a camera
frame with items in it. What was decided is in the journal. The loop only appends to lists: packing and
writing happen in a thread.
"""

import asyncio
import json
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from calibration.belt.pursuit import PursuitState
from cell.clock import Clock
from cell.devices import Encoder, EncoderState
from cell.formats.intercept import SCHEMA
from cell.samples import Sample
from cell.store.files import to_json, write_atomic
from cell.store.framed import FramedWriter, read_framed
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.items import Item

COUNTS_FILE, STEPS_FILE, SIGHTINGS_FILE = "counts.framed", "steps.framed", "sightings.framed"
BELIEF_FILE = "belief.framed"
DATA_FILE = "intercept.json"
COUNT = np.dtype([("t", "<f8"), ("count", "<i8")])
STEP = np.dtype([("t", "<f8"), ("p", "<f8", 4), ("v", "<f8", 4), ("belt_m_s", "<f8"), ("item", "<i8")])
BELIEF = np.dtype([(name, "<f8") for name in ("t", "raw_m", "raw_m_s", "travel_m", "speed_m_s")])
KEPT_S = 900.0  # of the end of a run, in its data set; all of it is in the framed files
HORIZONS_S = (0.03, 0.1, 0.3, 0.6)
_WRITE_EACH_S = 0.1
_LAST_LOOK_S = 0.1  # before contact


class PickRecord:
    """``async with``: listens to the encoder, is told the rest, and writes the data set when it ends.

    ``header`` is the data set without its rows: ``belt``, ``robot``, ``zone`` and so on.
    """

    def __init__(self, folder: Path, clock: Clock, encoder: Encoder, header: Mapping[str, Any]) -> None:
        self._folder, self._clock, self._encoder, self._header = folder, clock, encoder, header
        self._fresh = _Rows()
        self._recent: deque[_Rows] = deque()
        self._files: dict[str, FramedWriter] = {}
        self._lock = Lock()
        self.camera: Mapping[str, Any] | None = None  # that saw the items, and what they were placed with
        self._failure: Exception | None = None
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        for name in (COUNTS_FILE, STEPS_FILE, SIGHTINGS_FILE, BELIEF_FILE):
            self._files[name] = await asyncio.to_thread(FramedWriter, self._folder / name)
        self._undo = self._encoder.counts.subscribe(self._count)
        self._task = asyncio.create_task(self._write_on(), name="pick record")
        return self

    async def __aexit__(self, *_: object) -> None:
        self._undo()
        await asyncio.shield(self._end())

    def saw(self, t_exposure: float, seq: int, items: list[tuple[int, Any, float, float]]) -> None:
        """Items in one camera frame: number, grasp point (3,) in the base, yaw of the longer side (rad), and
        what the detector states of the point (m)."""
        rows = [[number, *(float(x) for x in point), yaw, sigma] for number, point, yaw, sigma in items]
        self._fresh.sightings.append({"t": t_exposure, "recv": self._clock.now(), "seq": seq, "items": rows})

    def goes(self, t: float, state: PursuitState, belt_m_s: float, item: int) -> None:
        """Where a set-point has the tool at ``t``, the belt's speed as it is believed, the item (0: none).

        Raises what kept an earlier row from the disk.
        """
        if self._failure is not None:
            raise self._failure
        self._fresh.steps.append((t, tuple(state.p), tuple(state.v), belt_m_s, item))

    def believes(self, row: tuple[float, ...]) -> None:
        """The newest count at a decision, and what the estimator makes of it: a row of :data:`BELIEF`."""
        self._fresh.belief.append(row)

    def ended(self, item: Item) -> None:
        """An item's life is over; it is in journal and ledger, and here for the questions of the data set."""
        self._fresh.ended.append((item.number, list(item.history)))

    def _count(self, sample: Sample[EncoderState]) -> None:
        self._fresh.counts.append((sample.t, sample.value.count))

    async def _write_on(self) -> None:
        while self._failure is None:
            await self._clock.sleep(_WRITE_EACH_S)
            try:
                await asyncio.shield(asyncio.to_thread(self._write, self._take()))
            except Exception as exc:
                self._failure = exc

    def _take(self) -> "_Rows":
        """On the loop: what came since the last time."""
        rows, self._fresh = self._fresh, _Rows()
        rows.until = self._clock.now()
        self._recent.append(rows)
        while self._recent[0].until < rows.until - KEPT_S:
            self._recent.popleft()
        return rows

    def _write(self, rows: "_Rows") -> None:
        with self._lock:
            if rows.counts:
                self._files[COUNTS_FILE].append(np.array(rows.counts, dtype=COUNT).tobytes())
            if rows.steps:
                self._files[STEPS_FILE].append(np.array(rows.steps, dtype=STEP).tobytes())
            if rows.belief:
                self._files[BELIEF_FILE].append(np.array(rows.belief, dtype=BELIEF).tobytes())
            for seen in rows.sightings:
                self._files[SIGHTINGS_FILE].append(json.dumps(seen, allow_nan=False).encode())
            for file in self._files.values():
                file.flush()

    async def _end(self) -> None:
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task
        await asyncio.to_thread(self._finish, self._take())

    def _finish(self, last: "_Rows") -> None:
        try:
            self._write(last)
        finally:
            for file in self._files.values():
                file.close()
        header = self._header if self.camera is None else {**self._header, "camera": self.camera}
        if (data := data_set(header, list(self._recent))) is not None:
            write_atomic(self._folder / DATA_FILE, to_json(data) + "\n")


@dataclass
class _Rows:
    """What came within a tenth of a second."""

    counts: list[tuple[float, int]] = field(default_factory=list)
    steps: list[tuple[float, tuple[float, ...], tuple[float, ...], float, int]] = field(default_factory=list)
    belief: list[tuple[float, ...]] = field(default_factory=list)
    sightings: list[dict[str, Any]] = field(default_factory=list)
    ended: list[tuple[int, list[tuple[float, str]]]] = field(default_factory=list)
    until: float = 0.0


def read_rows(path: Path, kind: np.dtype[Any]) -> NDArray[Any]:
    """The whole rows of a framed file of :data:`COUNT`, :data:`STEP` or :data:`BELIEF`, in order."""
    frames, _ = read_framed(path)
    return np.frombuffer(b"".join(frames), dtype=kind)


def header_of(
    config: BeltTrackingConfig, belt: Mapping[str, Any], encoder: Encoder, wait: PursuitState
) -> dict[str, Any]:
    """What the data set says of belt, arm and zone; ``wait`` is the tool where it waits."""
    limits = config.limits
    return {
        "belt": {"m_per_count": belt["m_per_count"], "dir": list(belt["dir"]), "period": encoder.period_s},
        "robot": {
            "limits": {"v": limits.speed_m_s, "a": limits.accel_m_s2, "j": limits.jerk_m_s3},
            "wait_point": [float(x) for x in wait.p[:3]],
            "above": config.down_m,
        },
        "zone": {"min": config.zone.min_m, "max": config.zone.max_m},
        "dwell_s": config.dwell_s,
        "classic": {"T1_s": config.T1_s},
    }


def data_set(header: Mapping[str, Any], parts: Sequence[_Rows]) -> dict[str, Any] | None:
    """``cellward.intercept/1`` of what came last; None before the first two counts.

    Asked is where each item will be when its way to it begins, and a tenth of a second before contact.
    """
    counts = [row for part in parts for row in part.counts]
    if len(counts) < 2:
        return None
    seen = [sighting for part in parts for sighting in part.sightings]
    first = {row[0]: sighting["recv"] for sighting in reversed(seen) for row in sighting["items"]}
    asked = [q for part in parts for number, history in part.ended for q in _queries(number, history)]
    return {
        "schema": SCHEMA,
        **header,
        "encoder": [[t, n] for t, n in counts],
        "detections": [
            {"id": number, "t_recv": s["recv"], "t_exp": s["t"], "xy": [x, y], "z": z, "sigma": sigma}
            for s in seen
            for number, x, y, z, _yaw, sigma in s["items"]
        ],
        "queries": [q for q in asked if q["t"] >= first.get(q["id"], np.inf)],
    }


def _queries(number: int, history: Sequence[tuple[float, str]]) -> list[dict[str, Any]]:
    begun = next((t for t, what in history if what == "approach"), None)
    if begun is None:
        return []
    contact = next((t for t, what in history if what == "contact"), None)
    if contact is None:
        return [{"id": number, "t": begun, "horizons": list(HORIZONS_S)}]
    out = [{"id": number, "t": begun, "horizons": sorted([*HORIZONS_S, max(contact - begun, 0.0)])}]
    if contact - _LAST_LOOK_S > begun:
        out.append({"id": number, "t": contact - _LAST_LOOK_S, "horizons": [_LAST_LOOK_S]})
    return out
