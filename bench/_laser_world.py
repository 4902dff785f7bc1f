"""The scan of the crossed-beam jobs in a small world of its own, ten times as fast as a whole cell.

What decides where to cross is the job's code; arm, beams and polls are a few formulas. The arm is off by a
draw of its repeatability at each standstill and by a blend of the two around it under way, as in the twin.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.devices import InputsState, Speed
from cell.poses import Array
from cell.run_values import RunValues
from cell.samples import Sample
from daemon.worker import InlineWorker
from procedures.laser import scan as job_scan
from procedures.laser.config import BEAMS, LaserUpdateConfig, Search
from procedures.laser.pairs import HEIGHT
from procedures.laser.path import BeamStation, Course
from procedures.laser.record import PassRecord
from procedures.laser.sweep import Beam, BeamPass
from tests.kit.laser_scene import Beam as TrueBeam
from tests.kit.laser_scene import Part, _cylinder, _segments

DOWN = Rotation.from_rotvec([np.pi, 0.0, 0.0])
P_REF = np.array([0.0, 0.0, 0.18])
SPEED = Speed(0.25, 0.5, 1.0, 3.0)
POINT = np.array([0.5, 0.1, 0.2])
ABOVE_M, ALONG_M = 0.008, {"xs": 0.025, "ys": 0.02}  # where the way begins
STATE_S, POLL_S, STAMP_S, LATENCY_S, BEAM_RADIUS_M = 0.008, 0.005, 0.00025, 0.002, 5e-4
BAND_M = 5e-5  # by how much more distance a beam clears than it breaks
LATE_S = 0.04
# Half of what replies take, by one run on the wire: 1 % below 0.9 ms, half below 1.4, 90 % below 2.2.
QUICKEST_S, LONGER_S, PERIOD_SD_S = 8e-4, 3.3e-4, 4e-4
# Of daemon/demo/bay.toml.
SHORT = {"measure_speed_m_s": 0.025, "passes": 3, "lead_m": 0.003, "z_resolution_m": 5e-5}
HEIGHT_M, SLOPE = 2.5e-3, 1e-3
MAX_U_M = LaserUpdateConfig().max_U_m
ROUND, FLAT = Part(0.003, round=True, offset=(0.0, 0.0, -0.003)), Part(0.003)


@dataclass
class World:
    """Fixture, arm and polls; one draw of all of them by ``seed``.

    ``sigma`` (m) is one axis of the arm at a standstill, ``late`` the share of polls that come up to 40 ms
    late, ``replies`` says that they take as long as on the wire; ``warp`` is by how much, of the way from
    where a beam is crossed first, the arm goes too far in each direction for each direction: links, gears and
    sag, which change little over a fixture. ``lean`` (2,) rad is how the tool stands turned about the
    flange's x and y; ``shift`` (3,) m and ``turn`` (3,) rad bend it about its point, both in the flange.
    """

    seed: int
    part: Part = ROUND
    sigma: float = 1.4e-5
    late: float = 0.0
    replies: bool = False
    warp: float = 0.0
    lean: Array = field(default_factory=lambda: np.zeros(2))
    shift: Array = field(default_factory=lambda: np.zeros(3))
    turn: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        point = POINT + self.rng.uniform(-HEIGHT_M, HEIGHT_M, 3)
        slopes = self.rng.uniform(-SLOPE, SLOPE, 4)
        xs, ys = np.array([1.0, *slopes[:2]]), np.array([slopes[2], 1.0, slopes[3]])
        apart = np.array([0.0, 0.0, self.rng.uniform(0.0, 4e-4)])
        self.beams = {
            "xs": TrueBeam(point, xs / np.linalg.norm(xs), radius=BEAM_RADIUS_M),
            "ys": TrueBeam(point + apart, ys / np.linalg.norm(ys), radius=BEAM_RADIUS_M),
        }
        self.t = 100.0
        self.at, self.off = np.zeros(3), self._draw()
        self.gradient = self.warp * self.rng.standard_normal((3, 3)) if self.warp else np.zeros((3, 3))

    def bent(self, shift: Array, turn: Array) -> "World":
        """The same fixture some time later with the tool bent by this."""
        other = replace(self, shift=shift, turn=turn)
        other.beams, other.rng, other.t = self.beams, self.rng, self.t + 10.0
        other.gradient = self.gradient
        return other

    @property
    def T_flange_tool(self) -> RigidTransform:
        """Where the tool's frame truly is, in which it leans."""
        return RigidTransform.from_components(P_REF + self.shift, Rotation.from_rotvec(self.turn))

    def first_contact(self, beam: str) -> float:
        """How high (m) the point of the tool that is not bent is over the middle of a beam when it first
        breaks it."""
        direction = self.beams[beam].direction
        reach = BEAM_RADIUS_M
        if not self.part.round:
            # Of a flat end the rim comes first: where it is lowest over the rising beam.
            axis = (DOWN * self._lean).apply([0.0, 0.0, 1.0])
            down = direction[2] * direction - np.array([0.0, 0.0, 1.0])
            reach += self.part.radius * float(np.linalg.norm(down - (down @ axis) * axis))
        return reach - 0.5 * BAND_M

    @property
    def _lean(self) -> Rotation:
        return Rotation.from_rotvec([*self.lean, 0.0])

    def move(self, to: Array) -> None:
        """A move of the flange to ``to`` (3,) that nobody watches."""
        self.t += 0.3 + float(np.linalg.norm(to - self.at)) / SPEED.tcp_m_s
        self.at, self.off = np.array(to, dtype=float), self._draw()

    def sweep(self, beam: Beam, direction: int, to: Array, speed: float, after_s: float) -> BeamPass:
        """One way across at ``speed`` (m/s), and what the polls see."""
        step = to - self.at
        length = float(np.linalg.norm(step))
        begin, after = self.t + 0.02, self._draw()
        ride = _Ride(length, min(speed, float(np.sqrt(length * SPEED.tcp_m_s2))), SPEED.tcp_m_s2)
        fine = np.linspace(0.0, ride.total, int(length / 5e-6) + 2)
        way = ride.at(fine)[:, None] * step / length
        share = (fine / ride.total)[:, None]
        told = self.at + way
        first = POINT - ALONG_M[beam.name] * np.cross([0.0, 0.0, 1.0], beam.across) - DOWN.apply(P_REF)
        wrong = (told - first) @ self.gradient.T
        gap = self._gap(beam.name, told + wrong + (1.0 - share) * self.off + share * after)
        changes = [begin + float(fine[k]) + LATENCY_S for k in _changes(gap)]
        end = begin + ride.total + 0.02
        polls = self._polls(self.t - float(self.rng.random()) * POLL_S - after_s, end + POLL_S, changes)
        times = np.round(np.arange(self.t, end, STATE_S), 7)
        xyz = self.at + ride.at(times - begin)[:, None] * step / length
        self.t, self.at, self.off = end + 0.05, np.array(to, dtype=float), after
        return BeamPass(beam, direction, times, xyz, polls, False)

    def _draw(self) -> Array:
        found: Array = self.sigma * self.rng.standard_normal(3)
        return found

    def _gap(self, beam: str, flange: Array) -> Array:
        """(n,) m from the tool to the light, for the flange truly at (n, 3)."""
        turn = Rotation.from_rotvec(self.turn) * self._lean
        axis, true = (DOWN * turn).apply([0.0, 0.0, 1.0]), self.beams[beam]
        end = flange + DOWN.apply(P_REF + self.shift + turn.apply(np.array(self.part.offset)))
        if not self.part.round:
            return np.asarray(_cylinder(end, axis, self.part, true))
        return np.asarray(
            _segments(end, end - self.part.length * axis, true) - self.part.radius - true.radius
        )

    def _polls(self, t: float, end: float, changes: list[float]) -> tuple[Sample[InputsState], ...]:
        n = int((end - t) / POLL_S) + 2  # as many as there can be
        late = np.where(self.rng.random(n) < self.late, LATE_S * self.rng.random(n), 0.0)
        half = np.full(n, STAMP_S)
        reply = late + POLL_S * (0.2 + 0.8 * self.rng.random(n))  # a reply takes a moment
        period: Array | float = POLL_S
        if self.replies:
            half = QUICKEST_S + LONGER_S * self.rng.standard_gamma(2.0, n)
            reply, period = late + 2.0 * half, POLL_S + PERIOD_SD_S * self.rng.standard_normal(n)
        own = half - QUICKEST_S if self.replies else half
        lag = late + own * (2.0 * self.rng.random(n) - 1.0)
        sent = [t]
        for wait in np.maximum(reply, period).tolist():
            sent.append(sent[-1] + wait)
        begin = np.array([s for s in sent[:-1] if s < end])
        seen = np.searchsorted(changes, begin + lag[: len(begin)], side="right")
        found, level, count = [], False, 0
        for k, n_seen in enumerate(seen.tolist()):
            level, count = n_seen % 2 == 1, count + (level != (n_seen % 2 == 1))
            state = InputsState((level, level), (count, count))
            found.append(Sample(state, float(begin[k] + late[k]), float(half[k]), k))
        return tuple(found)


@dataclass(frozen=True)
class _Ride:
    """From rest to rest over ``length`` (m) at ``v`` (m/s) and ``a`` (m/s^2)."""

    length: float
    v: float
    a: float

    @property
    def total(self) -> float:
        """Seconds."""
        return self.length / self.v + self.v / self.a

    def at(self, t: Array) -> Array:
        """(n,) m at ``t`` (n,) s."""
        ramp = self.v / self.a
        steady = self.length / self.v - ramp
        u = np.clip(t, 0.0, self.total)
        up, down = np.minimum(u, ramp), np.clip(u - ramp - steady, 0.0, ramp)
        way = 0.5 * self.a * up**2 + self.v * np.clip(u - ramp, 0.0, steady)
        found: Array = way + self.v * down - 0.5 * self.a * down**2
        return found


def _changes(gap: Array) -> list[int]:
    """Where along ``gap`` (n,) m the beam breaks and clears; empty when it does not."""
    breaks, clears = gap < -0.5 * BAND_M, gap > 0.5 * BAND_M
    if not breaks.any():
        return []
    last = len(gap) - 1 - int(np.argmax(~clears[::-1]))
    return [int(np.argmax(breaks)), min(last + 1, len(gap) - 1)]


class _Clock:
    async def sleep(self, seconds: float) -> None: ...


class _Inputs:
    names = BEAMS


class _Run:
    """As much of a run as a scan needs."""

    def __init__(self) -> None:
        self.clock, self.worker, self.state, self.step = _Clock(), InlineWorker(), None, 0
        self.values = RunValues({"model": "ur10e"})

    def inputs(self, role: str) -> _Inputs:
        return _Inputs()

    def arm(self) -> None: ...

    async def enter(self, state: Any, detail: str = "") -> None:
        self.state = state

    def note(self, kind: str, **facts: Any) -> None: ...

    def progress(self, done: int, steps: int) -> None: ...

    async def take_step(self, name: str, take: Callable[[], Awaitable[Any]]) -> Any:
        return await take()


@dataclass
class _Lease:
    world: World

    async def move_linear(self, to: RigidTransform, speed: Speed | None = None) -> None:
        self.world.move(to.translation)

    async def move_joints(self, q: Array) -> None: ...


@dataclass
class _Sweeper:
    world: World
    lease: _Lease

    async def cross(
        self, beam: Beam, direction: int, to: RigidTransform, speed: Speed, after_poll_s: float = 0.0
    ) -> BeamPass:
        return self.world.sweep(beam, direction, to.translation, speed.tcp_m_s, after_poll_s)


class _Scan(job_scan.Scan):
    async def _dark(self) -> list[str]:
        return []


@dataclass
class Record(PassRecord):
    """Of one scan, kept in memory; ``ways`` counts all of them, ``near`` those near the tool's end."""

    ways: int = 0
    near: int = 0

    def add(self, ways: tuple[BeamPass, ...], phase: str, place: int, why_not: str | None) -> None:
        self.ways += len(ways)
        self.near += len(ways) if phase == HEIGHT else 0
        if why_not is None:
            self.passes += [{**w.as_pass(), "notes": {"phase": phase, "place": place}} for w in ways]


def search(max_poll_gap_s: float | None = None, short: bool = False) -> Search:
    """The job's defaults for a fixture here, or the ``short`` search of the demo."""
    beam = {"aux": "a", "distance_m": 0.03, "along_m": 0.05, "q": [0.0] * 6}
    beams = {
        "xs": {**beam, "input": "xs", "across": [0.0, 1.0, 0.0]},
        "ys": {**beam, "input": "ys", "across": [1.0, 0.0, 0.0]},
    }
    gap = {} if max_poll_gap_s is None else {"max_poll_gap_s": max_poll_gap_s}
    plan = {"device": "beams", "floor_m": 0.0, **beams, **gap, **(SHORT if short else {})}
    return Search.model_validate(plan)


def take(
    world: World,
    folder: Path,
    plan: Search,
    places: int,
    stated_m: float,
    tool: Array,
    max_U_m: float = MAX_U_M,
) -> Record:
    """All passes of one scan; ``tool`` (3,) m is the point that is believed, ``stated_m`` the arm's data
    sheet, ``max_U_m`` how far off 95 % of the points may be."""
    record, lease = Record(folder), _Lease(world)
    course = Course(tuple(_stations(plan, places, tool)), tool, DOWN)
    found: Any = _Scan(_Run(), plan, course, record, SPEED, 0.0, None, stated_m, 1, max_U_m)  # type: ignore[arg-type]
    with (
        patch.object(job_scan, "Sweeper", lambda *_: _Sweeper(world, lease)),
        patch.object(job_scan, "leave_fixture", _nothing),
    ):
        asyncio.run(found.take(lease))
    return record


async def _nothing(*_: object) -> None: ...


def _stations(plan: Search, places: int, tool: Array) -> list[BeamStation]:
    found = []
    for name in BEAMS:
        beam = plan.beam(name)
        start = POINT + np.array([0.0, 0.0, ABOVE_M]) - 0.5 * beam.distance_m * beam.across_unit
        start = start - ALONG_M[name] * beam.along_unit
        for place in range(places):
            flange = start + place * beam.along_m * beam.along_unit - DOWN.apply(tool)
            T = RigidTransform.from_components(flange, DOWN)
            found.append(BeamStation(name, place, np.zeros(6), T, beam.across_unit, beam.distance_m, False))
    return found
