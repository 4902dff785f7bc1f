"""The geometric rules: each gives slacks in metres, per sample and capsule; below zero the rule is broken."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.guard._body import Body
from cell.guard.geometry import segment_box_distance, segment_segment_distance, segments_in_union
from cell.guard.limits import Box, GuardLimits
from cell.poses import Array

_STILL_M = 1e-9  # from sample to sample: does not move


@dataclass(frozen=True)
class Finding:
    """The spot that decides: sample ``index``, ``slack_m`` (negative: broken), what and where in words."""

    index: int
    slack_m: float
    text: str
    needed_m: float = 0.0  # the slack that it should have had


@dataclass(frozen=True, eq=False)
class Slacks:
    """One rule at n samples: ``values`` (n, k) m, and what each of the k columns is about."""

    values: Array
    texts: Sequence[str]

    def smallest(self) -> Finding:
        """The tightest spot."""
        index, k = divmod(int(np.argmin(self.values)), self.values.shape[1])
        return Finding(index, float(self.values[index, k]), self.texts[k])

    def needed(self, limit: Array, clear_m: float) -> Array:
        """(n, k) or (n, 1): the slack that each column has to keep, see :meth:`first_below`."""
        needed = limit[:, None]
        if clear_m > 0.0:
            ends = np.minimum(self.values[0], self.values[-1])
            needed = np.maximum(needed, np.minimum(ends, clear_m))
        return needed

    def first_below(self, limit: Array, clear_m: float = 0.0) -> Finding | None:
        """The tightest column at the first sample with a slack below its ``limit`` (n,), or None.

        A column keeps ``clear_m`` as well, or as much as the nearer end of the path has anyhow.
        """
        needed = self.needed(limit, clear_m)
        below = self.values < needed
        if not below.any():
            return None
        index = int(np.argmax(below.any(axis=1)))
        needs = np.broadcast_to(needed[index], self.values.shape[1:])
        k = int(np.argmax(needs - self.values[index]))
        return Finding(index, float(self.values[index, k]), self.texts[k], float(needs[k]))


class Rules:
    """The rules for one body in one set of boxes; ``ends`` is (n, m, 2, 3) as :class:`Body` gives them."""

    def __init__(self, body: Body, limits: GuardLimits) -> None:
        self._body, self._limits = body, limits
        self._moving = np.flatnonzero(body.joints_before >= 1)
        self._swinging = np.flatnonzero(body.joints_before[: body.links] >= 2)
        self._held = np.flatnonzero(body.joints_before >= 5)
        self._low = np.array([b.low for b in limits.workspace])
        self._high = np.array([b.high for b in limits.workspace])
        # A workspace that begins above the base plate says where the tool may be, not that there is a floor.
        self._floor = min(float(np.min(self._low[:, 2])), 0.0)
        # The boxes that are left to the axis of each capsule, (k, b, 3).
        radii = body.radii[self._held][:, None, None]
        self._held_low, self._held_high = self._low + radii, self._high - radii
        names = [box.name for box in limits.keep_out]
        self._box_texts = {name: self._texts(self._moving, f"keep-out box '{name}'") for name in names}
        self._workspace_texts = self._texts(self._held, "the workspace")
        self._floor_texts = self._texts(self._swinging, "the floor")
        self._self_texts = [
            f"'{body.names[q]}' and the arm's own '{body.names[p]}'" for p, q in body.self_pairs
        ]

    def first_broken(self, ends: Array, limit: Array, clear_m: float = 0.0) -> Finding | None:
        """The rule broken earliest, with a slack below what that sample of a path needs, or None.

        That is its ``limit`` (n,), and ``clear_m`` as far as the ends of the path have it.
        """
        found = (rule.first_below(limit, clear_m) for rule in self._all(ends, clear_m))
        return min((f for f in found if f is not None), key=lambda f: f.index, default=None)

    def spare(self, ends: Array, limit: Array, clear_m: float, turned_m: Array) -> Array:
        """(n,): from each of the samples that are seen, over how many more every rule is kept; negative where
        one is broken.

        From one sample of the path to the next joint i moves no point by more than ``turned_m[i]`` (6,).
        """
        *outside, own = self._all(ends, clear_m)
        before = np.append(0.0, np.cumsum(turned_m))[self._body.joints_before]
        i, j = self._body.self_pairs.T  # two parts come nearer by what turns between them
        steps = [*(np.sum(turned_m) for _ in outside), before[j] - before[i]]
        found = np.full(len(ends), np.inf)
        for rule, step in zip((*outside, own), steps, strict=True):
            left = (rule.values - rule.needed(limit, clear_m)) / np.maximum(step, _STILL_M)
            np.minimum(found, np.min(left, axis=1, initial=np.inf), out=found)
        return found

    def kept(self, ends: Array, clear_m: float = 0.0) -> NDArray[np.bool_]:
        """(n,): at which samples every rule is kept with ``clear_m`` to spare."""
        good = np.ones(len(ends), dtype=bool)
        for rule in self._all(ends, clear_m):
            good &= (rule.values >= clear_m).all(axis=1)
        return good

    def _all(self, ends: Array, within: float) -> tuple[Slacks, ...]:
        boxes = self.keep_out(ends, within)
        return (*boxes, self.workspace(ends), self.floor(ends), self.self_contact(ends))

    def keep_out(self, ends: Array, within: float = 0.0) -> list[Slacks]:
        """Every moving capsule outside every keep-out box; the base is bolted down and cannot run into one.

        Slacks above ``within`` are lower bounds from bounding boxes.
        """
        segments = ends.take(self._moving, axis=1).reshape(-1, 2, 3)
        radii = np.tile(self._body.radii[self._moving], len(ends))
        return [self._keep_out_of(box, segments, radii, within) for box in self._limits.keep_out]

    def _keep_out_of(self, box: Box, segments: Array, radii: Array, within: float) -> Slacks:
        a, b = segments[:, 0], segments[:, 1]
        gap = np.maximum(box.low - np.maximum(a, b), np.minimum(a, b) - box.high)
        slack = np.linalg.norm(np.maximum(gap, 0.0), axis=1) - radii
        close = np.flatnonzero(slack < within)
        exact = segment_box_distance(segments[close, 0], segments[close, 1], box.low, box.high)
        slack[close] = exact - radii[close]
        values = slack.reshape(-1, len(self._moving))
        return Slacks(values, self._box_texts[box.name])

    def workspace(self, ends: Array) -> Slacks:
        """Wrist 3 and everything on the flange inside the union of the workspace boxes, surfaces included."""
        held, low, high = ends.take(self._held, axis=1), self._held_low, self._held_high
        # A box is convex: a segment is as deep inside as its shallower end, in the best box.
        apart = held[:, :, None]
        inside = np.minimum(apart - low[:, :, None], high[:, :, None] - apart)
        depth: Array = inside.min(axis=(3, 4)).max(axis=2)
        if len(self._low) > 1:  # 0 where only several boxes together hold a segment
            for k in np.flatnonzero((depth < 0.0).any(axis=0)):
                out = np.flatnonzero(depth[:, k] < 0.0)
                joined = segments_in_union(held[out, k, 0], held[out, k, 1], low[k], high[k])
                depth[out[joined], k] = 0.0
        return Slacks(depth, self._workspace_texts)

    def floor(self, ends: Array) -> Slacks:
        """The links that swing (not base and shoulder, whose height never changes) above the floor."""
        heights = ends[..., 2].take(self._swinging, axis=1)
        lowest = np.minimum(heights[..., 0], heights[..., 1])
        values = lowest - self._body.radii[self._swinging] - self._floor
        return Slacks(values, self._floor_texts)

    def self_contact(self, ends: Array) -> Slacks:
        """Wrist and tool clear of the arm's own base, shoulder, upper arm and forearm."""
        i, j = self._body.self_pairs.T
        a, b = (ends.take(k, axis=1).reshape(-1, 2, 3) for k in (i, j))
        distance = segment_segment_distance(a[:, 0], a[:, 1], b[:, 0], b[:, 1]).reshape(len(ends), -1)
        return Slacks(distance - self._body.radii[i] - self._body.radii[j], self._self_texts)

    def _texts(self, capsules: NDArray[np.intp], what: str) -> list[str]:
        return [f"'{self._body.names[k]}' and {what}" for k in capsules]
