"""What a laser tracker or a total station offers: points of one reflector, and how good they are."""

from dataclasses import dataclass
from typing import Protocol

from cell.devices import Device
from cell.poses import Array
from cell.samples import Sample, Stream

MOST_SIGMA0_M, MOST_SIGMA_PER_M = 0.1, 1e-3  # that an instrument may have stated of it, see TrackerNoise


@dataclass(frozen=True, slots=True)
class TrackerState:
    """What a tracker sees now; ``point`` is None while it has no distance."""

    point: Array | None  # (3,) of the reflector's centre in the tracker frame, m
    locked: bool
    status: str = ""  # in the instrument's words, when something is not as it should be
    rotation: Array | None = None  # (3,) rotation vector of a six-degree target, rad; see tracker-lines


@dataclass(frozen=True)
class StablePoint:
    """The mean of the readings within a window during which the reflector stood still, or one point that the
    instrument's own program has measured."""

    point: Array  # (3,) tracker frame, m
    scatter_m: float  # RMS distance of the readings from their mean; of one reading 0
    count: int
    window_s: float
    temperature_c: float | None = None
    pressure_pa: float | None = None
    warnings: tuple[str, ...] = ()  # codes and words of what the instrument doubts; the point is valid
    sigma_m: float | None = None  # along one axis, where the sender states it of this very point
    rotation: Array | None = None  # (3,) rotation vector of a six-degree target, rad; kept, and not used

    def kept_rotation(self) -> dict[str, list[float]]:
        """``rotation`` as an entry of a data set's sample; empty where the sender gives none."""
        return {} if self.rotation is None else {"rotation": [float(v) for v in self.rotation]}


@dataclass(frozen=True)
class TrackerNoise:
    """Standard deviation of one reading along one axis: ``sigma0_m`` plus ``sigma_per_m`` times the range."""

    sigma0_m: float
    sigma_per_m: float


class LaserTracker(Device, Protocol):
    """A laser tracker or total station that follows one reflector at a time.

    A reflector that cannot be measured is a state, not the end of the link: ``find`` and ``measure`` raise
    ``TRACKER_NO_TARGET``, ``TRACKER_BEAM_BROKEN`` or ``TRACKER_UNSTABLE`` and may be called again.
    """

    noise: TrackerNoise  # as stated for the instrument; results are weighed with it
    readings: Stream[TrackerState]

    async def select(self, reflector: str) -> None:
        """Use the constant of this reflector from now on (``[device.NAME] reflectors``); read back."""
        ...

    async def find(self, near: Array | None, timeout: float) -> None:
        """Point at ``near`` (3,), tracker frame, or stay; search there and lock."""
        ...

    async def measure(self, window_s: float, max_scatter_m: float, timeout: float) -> Sample[StablePoint]:
        """A stable point read wholly after the call; ``t`` is the middle of the window, ``dt`` its half."""
        ...
