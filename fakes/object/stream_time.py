"""When an arm on virtual time is where a stream has it: late, slowly under the slider and at joints' limits.

As :mod:`fakes.world.arm.servo` has it cycle by cycle, in pieces: the controller works off what was sent at a
rate, which is the slider's share times what the fastest joint leaves. One difference: what the arm fell
behind it keeps until the stream ends, where the other one catches up. Whoever streams is told within a few
cycles that the controller is slow, and ends the stream.
"""

from itertools import pairwise
from math import inf

import numpy as np

from cell.poses import Array
from fakes.world.arm.ripple import Ripple
from fakes.world.arm.segments import Polynomial
from fakes.world.arm.servo import BEGUN_ANEW_S
from fakes.world.arm.track import Track
from fakes.world.arm.truth import ArmTruth
from fakes.world.timeline import Timeline

_LOOKS = 5  # along a piece, for its fastest joint
_SLICE_S = 0.01  # of a piece that asks too much, with a rate of its own


class StreamTime:
    """Puts what is sent on ``track``. Times in s, joints (6,) rad."""

    def __init__(self, track: Track, truth: ArmTruth, seed: int) -> None:
        self._track, self._lag = track, truth.servo.lag
        self._fastest, self._ripple = _fastest(truth), Ripple.of(truth.servo, seed)
        self._fraction = 1.0
        self._rates: list[
            tuple[float, float, float]
        ] = []  # from so much of the stream on: when, and how fast
        self._left: Timeline[float] = Timeline(1.0)
        self._limited_until = -inf

    @property
    def fraction(self) -> float:
        """The speed slider's share of full speed."""
        return self._fraction

    def limiting(self, t: float) -> float:
        """What the joints' limits leave of the speed that was wanted at ``t``; 1 while nothing is."""
        return self._left.at(t)

    def begin(self) -> None:
        """What follows next is another stream."""
        self._rates = []

    def follow(self, sent: Polynomial, late_s: float) -> None:
        """``sent`` replaces what was planned from its begin on; at full speed the arm is ``late_s`` late."""
        if self._lag == "none":
            self._track.follow(sent)
            return
        if not self._rates:
            waits = late_s / self._fraction if self._lag == "delay" else 0.0
            self._rates = [(sent.t0, sent.t0 + waits, self._fraction)]
        if sent.t0 < self._limited_until:
            self._left.put(sent.t0, 1.0)
        for begin, end, asked in self._slices(sent):
            left = 1.0 / max(asked * self._fraction, 1.0)
            if left < 1.0:
                self._left.put(begin, left)
                self._limited_until = end + BEGUN_ANEW_S
                self._left.then(self._limited_until, 1.0)
            when, rate = self._when(begin), self._fraction * left
            if rate != self._rates[-1][2] or begin < self._rates[-1][0]:
                known = [one for one in self._rates if one[0] < begin]
                self._rates = [*known[-1:], (begin, when, rate)]
            paced = Polynomial(begin, end, sent.origin, sent.coefficients).paced(begin, when, rate)
            lag = "none" if self._lag == "delay" else self._lag
            self._track.follow(paced, lag, late_s / rate, self._ripple)

    def set_fraction(self, t: float, fraction: float) -> None:
        """The slider is at ``fraction`` from ``t`` on, for what is under way, too."""
        change, self._fraction = fraction / self._fraction, fraction
        if change == 1.0 or not self._rates:
            return
        past = [one for one in self._rates if one[1] <= t][-1:]
        to_come = [one for one in self._rates if one[1] > t]
        self._rates = [(sent + (t - when) * rate, t, rate * change) for sent, when, rate in past]
        self._rates += [(sent, t + (when - t) / change, rate * change) for sent, when, rate in to_come]
        self._track.pace(t, change)

    def _when(self, sent: float) -> float:
        """The arm will be where the stream is at ``sent``, as far as is known."""
        begin, when, rate = next((one for one in reversed(self._rates) if one[0] <= sent), self._rates[0])
        return when + (sent - begin) / rate

    def _slices(self, sent: Polynomial) -> list[tuple[float, float, float]]:
        """Parts of ``sent`` and what share of a joint's highest speed each asks for."""
        asked = self._asked(sent, sent.t0, sent.t1)
        if asked * self._fraction <= 1.0:
            return [(sent.t0, sent.t1, asked)]
        count = int(np.ceil((sent.t1 - sent.t0) / _SLICE_S))
        ends = np.linspace(sent.t0, sent.t1, count + 1).tolist()
        return [(a, b, self._asked(sent, a, b)) for a, b in pairwise(ends)]

    def _asked(self, sent: Polynomial, begin: float, end: float) -> float:
        k = np.arange(1, len(sent.coefficients))
        at = np.linspace(begin, end, _LOOKS)[:, None] - sent.origin
        return float(np.max(np.abs(at ** (k - 1.0) @ (k[:, None] * sent.coefficients[1:])) / self._fastest))


def _fastest(truth: ArmTruth) -> Array:
    """(6,) rad/s; without a limit of an arm of which none is known."""
    try:
        return truth.controller_limits.reached(truth.model)
    except ValueError:
        return np.full(6, inf)
