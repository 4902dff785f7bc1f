"""What a controller makes of servoj's set-points: the arm is on them late, and as fast as its joints turn.

UR's own filter is not published. What is known: the arm is late by the look-ahead time and a few
milliseconds of wire and cycle (34 ms at ``lookahead_time`` 0.03 on a UR10e, Universal_Robots_Client_Library
issue 86; 35 ms on a UR5, Universal_Robots_ROS2_Driver issue 1311). Two filters with that delay bracket it: a
pure delay, which keeps the shape, and a low-pass of first order, which rounds corners. ``gain`` is taken as
the P-term that UR's script manual calls it, so it adds its inverse to both (an assumption: 0.8 ms of the 34
at that user's 1200).

The speed slider scales the controller's time: below full speed it works off what was sent more slowly than it
comes, and the arm falls behind for as long as that lasts (Universal_Robots_ROS_Driver pull request 250,
ur_modern_driver issue 302). No joint turns faster than its model lets: all are slowed until it does not, and
the arm falls behind for as long as set-points ask for more (the same pull request), beside their path.

What was sent is no queue: a thread of the controller hands servoj the newest set-point each cycle
(ur_modern_driver issue 153). So the arm is taken to catch up, as fast as its joints turn, once it may: at
full speed again, and after a set-point that leaped, as where a PC was late.
"""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from cell.poses import Array
from fakes.world.arm.ripple import Ripple
from fakes.world.arm.segments import largest
from fakes.world.arm.truth import ServoTruth

BEGUN_ANEW_S = 0.02  # without a set-point, as after servo_stop


def lag_s(lookahead_s: float, gain: float) -> float:
    """How late the arm is on its set-points, s."""
    return lookahead_s + 1.0 / gain


class Servo:
    """One control cycle after the other. Joints (6,) rad, times in s."""

    def __init__(self, truth: ServoTruth, fastest: Array, ripple: Ripple | None = None) -> None:
        self._lag, self._fastest, self._ripple = truth.lag, fastest, ripple
        self._more_s = truth.more_s
        self._line: deque[tuple[float, Array]] = deque()
        self._own = 0.0  # the controller's time on its way through what was sent
        self._at: Array = np.zeros(6)
        self._scaling = 1.0  # what the joints' limits leave of the latest set-point's speed

    def limiting(self, t: float) -> float:
        """What the joints' limits leave of the speed that was wanted at ``t``; 1 while nothing is."""
        return self._scaling if self._line and t - self._line[-1][0] <= BEGUN_ANEW_S else 1.0

    def step(
        self,
        t: float,
        here: Callable[[], Array],
        wanted: ArrayLike,
        late_s: float,
        period_s: float,
        fraction: float,
    ) -> Array:
        """Where the arm is to be one cycle after ``t``; it is ``here()``, and ``wanted`` was sent."""
        if not self._line or t - self._line[-1][0] > BEGUN_ANEW_S:
            self._at, self._own = here(), t
            self._line = deque([(t - period_s, self._at)])
        self._line.append((t, np.array(wanted, dtype=float)))
        self._own += period_s * fraction
        if fraction >= 1.0:
            self._own = t + period_s
        (t0, q0), (t1, q1) = self._line[-2], self._line[-1]
        asked = largest((q1 - q0) / ((t1 - t0) * self._fastest))
        self._scaling = 1.0 / max(asked * fraction, 1.0)
        step = self._filtered(late_s + self._more_s, period_s * fraction) - self._at
        over = largest(step / (period_s * self._fastest))
        step = step / max(over, 1.0)
        self._at = self._at + step
        if self._ripple is None:
            return self._at
        return self._at + self._ripple.deviation(self._at, step / period_s)

    def _filtered(self, late_s: float, passed_s: float) -> Array:
        if self._lag == "delay":
            return self._sent(self._own - late_s)
        smoothed: Array = self._at + (self._sent(self._own) - self._at) * (1.0 - np.exp(-passed_s / late_s))
        return smoothed

    def _sent(self, t: float) -> Array:
        """What was sent for ``t``; what is older is forgotten."""
        line = self._line
        while len(line) > 2 and line[1][0] <= t:
            line.popleft()
        (t0, q0), (t1, q1) = line[0], line[min(1, len(line) - 1)]
        return q0 + (q1 - q0) * (min(max((t - t0) / (t1 - t0), 0.0), 1.0) if t1 > t0 else 1.0)
