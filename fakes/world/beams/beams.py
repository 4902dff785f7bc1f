"""Light beams across the cell: the exact times at which the tool breaks them and lets them through.

A beam is broken from when the tool is nearer than the sum of the radii by half the hysteresis until it is
farther by the other half. Nothing is computed before somebody asks, and then only as far as is asked and a
little beyond: a plan that is replaced costs nothing, and a tool that cannot be there yet is not looked at.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping

import numpy as np

from cell.poses import Array
from fakes.world.arm.crossings import crossings, mesh
from fakes.world.arm.distance import to_segments
from fakes.world.arm.segments import Segment
from fakes.world.arm.tool_motion import Piece, ToolMotion
from fakes.world.beams.truth import BeamTruth

Snapshot = tuple[float, list[bool], list[int], list[list[float]]]

_WAY_M = 0.06  # a window of samples is as long as the tool may need for this way
_STEP_M = _WAY_M / 96
_LONGEST_S = 1.5
_WORTH_M = 0.004  # from here on it is cheaper to wait until the tool may have come
_UNSEEN_SEGMENTS = 16  # so many may pile up unasked: looking at them must not hold up who commands the arm
_HISTORY_S = 60.0
_MOST_EDGES = 4096
_ROUNDING_S = 1e-9


class Beams:
    """All beams of a cell; every answer is a function of time (s on the twin's clock).

    ``t`` is the time at the sensor's output: what the light does shows ``latency_s`` later. ``version``
    changes when edges that had been foreseen were replaced; ``foreseen`` changes whenever what had been
    foreseen was replaced, also where that was no edge.
    """

    def __init__(self, beams: Mapping[str, BeamTruth], motion: ToolMotion, radii: Array, t0: float) -> None:
        self.names, self.version, self.foreseen = tuple(beams), 0, 0
        self._index = {name: i for i, name in enumerate(self.names)}
        truths = list(beams.values())
        self._latency = [beam.latency_s for beam in truths]
        self._centres = np.array([beam.point for beam in truths], dtype=float).reshape(-1, 3)
        ways = np.array([beam.dir for beam in truths], dtype=float).reshape(-1, 3)
        self._ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)
        self._halves = 0.5 * np.array([beam.length_m for beam in truths])
        self._reach = np.array([beam.radius_m for beam in truths])[:, None] + radii  # (b, m)
        self._half_band = 0.5 * np.array([beam.hysteresis_m for beam in truths])
        self._motion = motion
        self._edges: list[list[float]] = [[] for _ in truths]
        self._dropped = [0] * len(truths)
        self._known = t0
        self._room = np.zeros(len(truths))  # how far each beam is from changing at that time, at least
        self._speed_since = (t0, 0.0)  # the last piece looked at, and the speed in it
        self._judged: tuple[Piece, float] | None = None  # where the room is no bound but what there is
        gaps = self._gaps(motion.piece(t0), np.array([t0]))[0] if truths else np.zeros(0)
        self._at_first: list[bool] = (gaps < 0.0).tolist()

    # -- what anybody may ask

    def level(self, name: str, t: float) -> bool:
        """Whether the sensor shows at ``t`` that its beam is broken."""
        return self._level(self._index[name], self.index(name, t))

    def index(self, name: str, t: float) -> int:
        """How many edges the sensor has shown by ``t`` since the world began."""
        i = self._index[name]
        t -= self._latency[i]
        if t > self._known:
            self._look_until(t)
        return self._dropped[i] + bisect_right(self._edges[i], t)

    def quiet_until(self, name: str, t: float) -> float:
        """When the sensor may show its next edge after ``t``, as far as has been looked ahead."""
        i = self._index[name]
        edges = self._edges[i]
        k = bisect_right(edges, t - self._latency[i])
        return (edges[k] if k < len(edges) else self._known) + self._latency[i] - _ROUNDING_S

    def count(self, name: str, t: float) -> int:
        """How many of them were rising: the beam was broken."""
        return (self.index(name, t) + (not self._at_first[self._index[name]])) // 2

    def edges(self, name: str, t0: float, t1: float) -> list[tuple[float, bool]]:
        """Time and new level of the edges that the sensor shows in ``t0 < t <= t1``, as far as remembered."""
        i = self._index[name]
        first = max(self.index(name, t0) - self._dropped[i], 0)
        last = self.index(name, t1) - self._dropped[i]
        return [
            (self._edges[i][k] + self._latency[i], self._level(i, self._dropped[i] + k + 1))
            for k in range(first, last)
        ]

    # -- what happens in the world

    def on_segment(self, segment: Segment) -> None:
        """The arm is to do something else from the start of ``segment`` on."""
        self._motion.add(segment)
        self.on_change(segment.t0)
        if self._motion.after(self._known) > _UNSEEN_SEGMENTS:
            self._look_until(segment.t0)
        self._motion.forget(min(segment.t0 - _HISTORY_S, self._known))

    def on_change(self, t: float) -> None:
        """What was foreseen from ``t`` on does not hold."""
        if t >= self._known:
            return
        self._judged = None
        self.foreseen += 1
        since, speed = self._speed_since
        changed = False
        for edges in self._edges:
            keep = bisect_left(edges, t)
            changed = changed or keep < len(edges)
            del edges[keep:]
        self.version += changed
        if changed or t < since:
            self._room[:] = 0.0
        elif speed:
            self._room -= speed * (self._known - t)
        self._known = t

    def snapshot(self, t: float) -> Snapshot:
        """What a mirror starts from that knows the track from ``t`` on."""
        self._look_until(t)
        return self._known, list(self._at_first), list(self._dropped), [list(e) for e in self._edges]

    def load(self, snapshot: Snapshot, motion: ToolMotion) -> None:
        """Become a copy of the beams whose :meth:`snapshot` this is."""
        self._motion = motion
        self._known, self._at_first, self._dropped, self._edges = snapshot
        self._room[:] = 0.0
        self._speed_since, self._judged = (self._known, 0.0), None
        self.version += 1
        self.foreseen += 1

    # -- looking ahead

    def _level(self, i: int, edges: int) -> bool:
        return self._at_first[i] != bool(edges % 2)

    def _look_until(self, t: float) -> None:
        if not self.names:
            return
        while self._known < t:
            piece = self._motion.piece(self._known)
            self._room -= piece.leap
            self._look_through(piece, t)
        for i, edges in enumerate(self._edges):
            if len(edges) > _MOST_EDGES:
                self._dropped[i] += len(edges) // 2
                del edges[: len(edges) // 2]

    def _look_through(self, piece: Piece, t: float) -> None:
        """Look at ``piece`` until ``t``, or its end, and then until the end of the window of samples."""
        while self._known < min(t, piece.end):
            start, end = self._known, piece.end
            room = float(self._room.min())
            near = room <= 0.0 or (piece.speed and room < _WORTH_M and piece.speed * (end - start) >= room)
            if near and not self._is_judged(piece, start):
                self._judge(piece, np.array([start]))
                room = float(self._room.min())
            if piece.speed:
                free_s = room / piece.speed
                window_s = min(_WAY_M / piece.speed, _LONGEST_S)
                if start + free_s < end and free_s < window_s:
                    end = min(start + window_s, end)
                    steps = int(piece.speed * (end - start) / _STEP_M) + 1
                    self._judge(piece, np.linspace(start, end, steps + 1))
                    continue
                end = min(end, start + free_s)
            self._advance(piece, end)

    def _is_judged(self, piece: Piece, t: float) -> bool:
        """Whether ``t`` was the last time judged, of the motion that goes on with ``piece``."""
        if self._judged is None or self._judged[1] != t:
            return False
        before = self._judged[0]
        same = piece.segment is before.segment and piece.blend is before.blend and piece.ends is before.ends
        return same and piece.leap == 0.0

    def _advance(self, piece: Piece, end: float) -> None:
        if piece.speed:
            self._room -= piece.speed * (end - self._known)
        self._speed_since, self._known = (self._known, piece.speed), end

    def _judge(self, piece: Piece, times: Array) -> None:
        """Find the edges between the first and the last of ``times``, which become known."""
        found = mesh(lambda when: self._gaps(piece, when), times, piece.speed, self._half_band)
        for i, edges in enumerate(self._edges):
            inside = self._level(i, self._dropped[i] + len(edges))
            edges += crossings(
                lambda when, i=i: self._gaps(piece, when)[:, i],  # type: ignore[misc]
                found,
                i,
                float(self._half_band[i]),
                inside,
            )
            inside = self._level(i, self._dropped[i] + len(edges))
            gap = float(found.gaps[-1, i])
            self._room[i] = self._half_band[i] + (-gap if inside else gap)
        self._speed_since, self._known = (float(times[0]), piece.speed), float(times[-1])
        self._judged = piece, self._known

    def _gaps(self, piece: Piece, times: Array) -> Array:
        """Distance of the tool's nearest point from each beam's light, (n, b) m; negative inside."""
        distances = to_segments(piece.axes(times), self._centres, self._ways, self._halves)
        out: Array = (distances - self._reach).min(axis=2)
        return out
