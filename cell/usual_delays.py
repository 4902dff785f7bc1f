"""How late stamps are that nobody measured, by the kind of source, s.

Each figure is what this kind of device leaves with the drivers of this package; sizes of another make may be
larger, which only a measurement tells. What a job states where a delay was not measured, and what a rehearsal
draws, are these.
"""

from math import hypot, sqrt
from typing import NamedTuple


class Usual(NamedTuple):
    """A delay: how much it is on average, and its standard deviation about that, s."""

    mean_s: float
    sigma_s: float

    @property
    def rms_s(self) -> float:
        """About zero, as nobody subtracts the mean."""
        return hypot(self.mean_s, self.sigma_s)


def _anywhere(low: float, high: float, jitter: float = 0.0) -> Usual:
    """Anywhere from ``low`` to ``high``, and on average half of ``jitter`` later."""
    return Usual(0.5 * (low + high + jitter), (high - low) / sqrt(12.0))


# The clocks of camera and PC agree to 0.2 ms with USB and 0.5 ms with Ethernet, one standard deviation over
# hours (Luxonis, depthai-python pull request 933). The driver cannot tell the two apart, so it is the larger.
CAMERA = Usual(0.0, 0.0005)

# From the shaft to the stamp of its frame. A frame with a position is 95 bits at most, 0.4 ms at 250 kbit/s.
# Before it comes part of the encoder's own cycle, of which manuals tell the shortest timer (1 ms) alone, and
# after it, with an adapter on USB, its latency timer (1 ms by the service's rule for udev; the 16 ms of a PC
# without that rule are not covered) and a frame of USB (1 ms). That each of these takes any part of its time
# is an assumption.
ENCODER_LATE_S = (0.0004, 0.0034)
ENCODER_JITTER_S = 0.0005  # more, of a position that a task of its own looks at: an assumption
ENCODER = _anywhere(*ENCODER_LATE_S, ENCODER_JITTER_S)

# A controller sends its state in each cycle of 2 ms, and the stamps are brought onto our clock by the fastest
# packages. When in a cycle joints are read and the package is sent is not published: that it takes up to one
# cycle is an assumption.
ARM_LATE_S = (0.0, 0.002)
ARM = _anywhere(*ARM_LATE_S)
