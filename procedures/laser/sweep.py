"""One way across a light beam: the arm's poses and the polls of the inputs, recorded on one time axis."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.clock import Clock
from cell.devices import Arm, ArmState, DigitalInputs, InputsState, Speed, flange_poses
from cell.errors import error
from cell.inputs import Edge, edges
from cell.motion import MotionLease
from cell.poses import Array
from cell.samples import Sample

POLL_TIMEOUT_S = 0.5
STILL_M = 1e-4  # as near to where it rests the arm counts as not under way
STAMP_DIGITS = 7
BOUNCE_SHARE = 0.03  # of the time from the first change to the last
EDGE_WINDOW_S = 0.03  # on both sides of an edge: where the speed at the edge is read


@dataclass(frozen=True, eq=False)
class Beam:
    """A light beam and how it is crossed. ``across`` (3,) is the unit vector of the way out, in the base."""

    name: str
    index: int  # of its input in a poll
    across: Array


@dataclass(frozen=True, eq=False)
class BeamPass:
    """One way across a beam, out (``direction`` 1) or back (-1).

    ``t`` (n,) s and ``xyz`` (n, 3) m are the flange in the base; ``polls`` have stamps of the same time axis.
    ``restarted`` says that a stream began anew meanwhile, so that the two halves do not belong together.
    """

    beam: Beam
    direction: int
    t: Array
    xyz: Array
    polls: tuple[Sample[InputsState], ...]
    restarted: bool

    @property
    def z(self) -> float:
        """Height of the flange in the base, m."""
        return float(np.mean(self.xyz[:, 2]))

    def edges(self) -> list[Edge]:
        """The changes of the beam, oldest first, with the bounce of contacts taken out."""
        return without_bounce(edges(self.polls, self.beam.index))

    @property
    def triggered(self) -> bool:
        return bool(self.edges())

    @property
    def begins_dark(self) -> bool:
        """Whether the beam was broken before the way began."""
        return self.polls[0].value.levels[self.beam.index]

    @property
    def ends_dark(self) -> bool:
        return self.polls[-1].value.levels[self.beam.index]

    @property
    def poll_gap_s(self) -> float:
        """The longest time without a poll while the arm was under way."""
        t, (begin, end) = np.array([p.t for p in self.polls]), self._under_way
        first = max(int(np.searchsorted(t, begin, side="right")) - 1, 0)
        last = int(np.searchsorted(t, end))
        return float(np.max(np.diff(t[first : last + 1]), initial=0.0))

    @property
    def state_gap_s(self) -> float:
        """The longest time without a state of the arm."""
        return float(np.max(np.diff(self.t), initial=0.0))

    @property
    def blind_s(self) -> float:
        """For how long the arm was under way before the first poll, or after the last."""
        begin, end = self._under_way
        return max(self.polls[0].t - begin, end - self.polls[-1].t, 0.0)

    @property
    def _under_way(self) -> tuple[float, float]:
        """When the arm left where it began, and when it came to where it ended, s."""
        left = np.linalg.norm(self.xyz - self.xyz[0], axis=1) > STILL_M
        ahead = np.linalg.norm(self.xyz - self.xyz[-1], axis=1) > STILL_M
        if not left.any():
            return float(self.t[0]), float(self.t[-1])
        first, last = int(np.argmax(left)), len(ahead) - 1 - int(np.argmax(ahead[::-1]))
        return float(self.t[max(first - 1, 0)]), float(self.t[min(last + 1, len(self.t) - 1)])

    def along(self, t: Array) -> Array:
        """(k,) m: where the flange was at the times ``t`` (k,) s, along ``across``."""
        return np.interp(t, self.t, self.xyz @ self.beam.across)

    def edge_positions(self) -> Array:
        """(k,) m: where the flange was at each edge, along ``across``, in the order of the way out."""
        found = self.along(np.array([e.t for e in self.edges()]))
        return found[:: self.direction]

    def speed_at(self, t: float) -> float:
        """Speed along the way around ``t``, m/s; of a line fitted to the positions."""
        near = np.flatnonzero(np.abs(self.t - t) <= EDGE_WINDOW_S)
        if len(near) < 2:
            near = np.argsort(np.abs(self.t - t))[:2]
        slope, _ = np.polyfit(self.t[near] - t, self.xyz[near] @ self.beam.across, 1)
        return float(slope) * self.direction

    def speed_deviation(self) -> float:
        """How far the speed at any edge is off their mean, as a share of it; 0 without edges."""
        found = np.array([self.speed_at(e.t) for e in self.edges()])
        if not len(found):
            return 0.0
        mean = float(np.mean(found))
        return float(np.max(np.abs(found - mean)) / mean) if mean > 0.0 else float("inf")

    def as_pass(self) -> dict[str, Any]:
        """The PASS of a ``cellward.laser/1`` data set."""
        index = self.beam.index
        return {
            "beam": self.beam.name,
            "dir": self.direction,
            "z": round(self.z, 8),
            "pose_t": self.t.tolist(),
            "pose_xyz": np.round(self.xyz, 8).tolist(),
            "poll_t": [round(p.t, STAMP_DIGITS) for p in self.polls],
            "poll_v": [int(p.value.levels[index]) for p in self.polls],
            "poll_n": [p.value.changes[index] for p in self.polls],
            "poll_dt": [round(p.dt, 7) for p in self.polls],
        }


def without_bounce(found: list[Edge]) -> list[Edge]:
    """Changes that follow each other much faster than the crossing lasts are one change.

    A group of an odd number becomes one edge whose interval covers it; one of an even number is a flicker.
    """
    if len(found) <= 2:
        return found
    near = BOUNCE_SHARE * (found[-1].t - found[0].t)
    groups: list[list[Edge]] = []
    for edge in found:
        if groups and edge.t - groups[-1][-1].t < near:
            groups[-1].append(edge)
        else:
            groups.append([edge])
    spans = ((g[0], g[0].t - g[0].dt, g[-1].t + g[-1].dt) for g in groups if len(g) % 2)
    return [Edge(e.rising, 0.5 * (low + high), 0.5 * (high - low)) for e, low, high in spans]


class Recording:
    """Keeps what both streams give inside its ``with`` block; poll stamps are moved by ``-offset_s``."""

    def __init__(self, arm: Arm, inputs: DigitalInputs, offset_s: float) -> None:
        self.states: list[Sample[ArmState]] = []
        self.polls: list[Sample[InputsState]] = []
        self._arm, self._inputs, self._offset_s = arm, inputs, offset_s
        self._came = asyncio.Event()
        self._end: list[Any] = []

    def __enter__(self) -> Self:
        self._epochs = self._now()
        self._end = [self._arm.state.subscribe(self.states.append), self._inputs.inputs.subscribe(self._take)]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        ends, self._end = self._end, []  # else a circle of references keeps thousands of samples
        for unsubscribe in ends:
            unsubscribe()

    @property
    def restarted(self) -> bool:
        """Whether a stream began anew since."""
        return self._now() != self._epochs

    async def poll_after(self, t: float, timeout: float) -> bool:
        """True once a poll begun after ``t`` (the polls' own stamps) is here; False after ``timeout`` s."""
        try:
            async with asyncio.timeout(timeout):
                while not self.polls or self.polls[-1].t + self._offset_s - self.polls[-1].dt < t:
                    self._came.clear()
                    await self._came.wait()
        except TimeoutError:
            return False
        return True

    def _take(self, sample: Sample[InputsState]) -> None:
        if self._offset_s:
            t = sample.t - self._offset_s
            sample = Sample(sample.value, t, sample.dt, sample.seq, sample.quality)
        self.polls.append(sample)
        self._came.set()

    def _now(self) -> tuple[int, int]:
        return self._arm.state.epoch, self._inputs.inputs.epoch


@dataclass(frozen=True)
class Sweeper:
    """Moves across beams and records. ``offset_s`` is what the stamps of the polls are late by."""

    arm: Arm
    inputs: DigitalInputs
    lease: MotionLease
    clock: Clock
    offset_s: float = 0.0

    async def cross(
        self, beam: Beam, direction: int, to: RigidTransform, speed: Speed, after_poll_s: float = 0.0
    ) -> BeamPass:
        """Move the tool on a line until the flange is at ``to``; begins ``after_poll_s`` after a poll.

        ``STALE_DATA`` when there is no poll to begin with: nothing moves blindly across a beam.
        """
        with Recording(self.arm, self.inputs, self.offset_s) as seen:
            if not await seen.poll_after(self.clock.now(), POLL_TIMEOUT_S):
                raise error("STALE_DATA", f"{self.inputs.name} gave no poll within {POLL_TIMEOUT_S:g} s")
            if after_poll_s > 0.0:
                await self.clock.sleep(after_poll_s)
            await self.lease.move_linear(to, speed)
            # The beam's last change on this way may still be on its way to us.
            await seen.poll_after(self.clock.now() + self.offset_s, POLL_TIMEOUT_S)
        # Poses of thousands of states at once would hold up the loop.
        return await asyncio.to_thread(way_of, beam, direction, seen.states, seen.polls, seen.restarted)


def way_of(
    beam: Beam,
    direction: int,
    states: Sequence[Sample[ArmState]],
    polls: Sequence[Sample[InputsState]],
    restarted: bool = False,
) -> BeamPass:
    """A way from its samples; at least one of each."""
    if not states:
        raise error("STALE_DATA", "the arm gave no state on a way across a beam")
    t = np.round([s.t for s in states], STAMP_DIGITS)
    new = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0.0)  # stamps of a burst may be one
    flange = flange_poses([states[int(i)].value for i in new]).translation
    return BeamPass(beam, direction, t[new], flange, tuple(polls), restarted)
