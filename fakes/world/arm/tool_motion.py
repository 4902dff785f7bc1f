"""The true tool's way through the base: pieces of time within which it moves smoothly and not too fast."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from math import inf

import numpy as np

from cell.poses import Array
from fakes.world.arm.kinematics import skew
from fakes.world.arm.repeatability import Blend, Repeatability
from fakes.world.arm.segments import Polynomial, Segment
from fakes.world.arm.sweep import fastest, joints
from fakes.world.arm.tool_shape import ToolShape
from fakes.world.arm.true_arm import TrueArm


@dataclass(frozen=True, eq=False)
class Piece:
    """The tool from ``start`` (s) to ``end``. No point of it is faster than ``speed`` (m/s); at ``start`` it
    may have leapt by ``leap`` (m) from where the piece before ends."""

    start: float
    end: float
    speed: float
    leap: float
    arm: TrueArm
    segment: Segment
    blend: Blend
    ends: Array  # of the capsules' axes in the flange, (m, 2, 3)

    def axes(self, times: Array) -> Array:
        """Ends of the capsules' axes in the base, (n, m, 2, 3) m, at ``times`` (n,) of this piece."""
        flange, xi = self.arm.matrix(joints(self.segment, times)), self.blend.many(times)
        turned, shift = flange[:, :3, :3], xi[:, :3, None]
        turn: Array | None = None
        if self.blend.turns:
            turn, shift = _small_moves(xi)
        place = (turned @ shift)[:, None, :, 0] + flange[:, None, :3, 3]
        if turn is not None:
            turned = turned @ turn
        out: Array = self.ends.reshape(-1, 3) @ turned.swapaxes(1, 2) + place
        return out.reshape(len(times), *self.ends.shape)


class ToolMotion:
    """The pieces, in order. It keeps the segments for itself: the track forgets what is long over."""

    def __init__(
        self, arm: TrueArm, repeatability: Repeatability, tool: ToolShape, track: list[Segment]
    ) -> None:
        self._arm, self._repeatability, self._tool = arm, repeatability, tool
        self._levers = arm.levers()
        self._segments, self._starts = list(track), [segment.t0 for segment in track]

    def add(self, segment: Segment) -> None:
        """The arm is to do ``segment`` from its start on, in place of what was planned."""
        keep = bisect_left(self._starts, segment.t0)
        self._segments[keep:], self._starts[keep:] = [segment], [segment.t0]

    def forget(self, t: float) -> None:
        """Nobody will ask for times before ``t`` any more."""
        old = max(bisect_right(self._starts, t) - 2, 0)  # one more, to see where it ended
        del self._segments[:old], self._starts[:old]

    def after(self, t: float) -> int:
        """How many segments begin after ``t``."""
        return len(self._starts) - bisect_right(self._starts, t)

    def piece(self, t: float) -> Piece:
        """What goes on from ``t`` until something changes."""
        i = max(bisect_right(self._starts, t) - 1, 0)
        segment = self._segments[i]
        blend = self._repeatability.blend_at(t)
        ends, lever = self._tool.ends_at(t)
        # Set-points come 500 times a second, and when the last one would end in rest is a costly question.
        rest = segment.t1 if isinstance(segment, Polynomial) and t < segment.t1 else segment.t_end
        changes = [rest, blend.end, self._tool.next_bend(t), *self._starts[i + 1 : i + 2]]
        speed = blend.rate(t, lever)
        if t < rest:
            speed += float(fastest(segment) @ (self._levers + lever))
        end = min([change for change in changes if change > t], default=inf)
        return Piece(t, end, speed, self._leap(i, t, lever), self._arm, segment, blend, ends)

    def _leap(self, i: int, t: float, lever: float) -> float:
        if self._tool.bent_at(t):
            return inf
        if i == 0 or self._starts[i] != t:
            return 0.0
        change = self._segments[i].at(t)[0] - self._segments[i - 1].at(t)[0]
        return float(np.abs(change) @ (self._levers + lever))


def _small_moves(xi: Array) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and shifts (n, 3, 1) m of ``exp(xi)`` for small ``xi`` (n, 6).

    With W the rotation's cross product matrix and a its angle, W^3 is -a^2 W, which leaves W and W^2 of the
    series; after three terms of each factor less than 1e-16 is left at 0.01 rad.
    """
    W = skew(xi[:, 3:])
    square = W @ W
    aa = np.sum(xi[:, 3:] ** 2, axis=1)[:, None, None]
    first = 1.0 - aa / 6.0 * (1.0 - aa / 20.0)
    second = 0.5 - aa / 24.0 * (1.0 - aa / 30.0)
    third = 1.0 / 6.0 - aa / 120.0 * (1.0 - aa / 42.0)
    p = xi[:, :3, None]
    return np.eye(3) + first * W + second * square, p + second * (W @ p) + third * (square @ p)
