"""A program that measures a point when it is asked to, as ``cell.laser_tracker.LaserTracker``."""

from typing import Self

from pydantic import Field, model_validator

from cell.errors import error
from cell.laser_tracker import StablePoint
from cell.poses import Array
from cell.samples import Sample
from drivers.tracker.line_config import STATED, LineStreamConfig
from drivers.tracker.line_stream import LineStreamTracker
from drivers.tracker.wire import Link

_OF_STREAMS = ("min_readings", "poll_period_s", "stamp_uncertainty_s", "broken_after_s", "find_radius_m")


class LinePointConfig(LineStreamConfig):
    """Keys of a device with ``driver = "line-points"``: a program that measures one point at each request."""

    silence_s: float = Field(
        default=20.0,
        ge=0.5,
        le=300.0,
        description="No answer to a request for longer ends the link: it would be that of another pose",
    )
    lost_after_bad: int = Field(
        default=1, ge=1, le=10_000, description="Lines in a row that cannot be read that end the link"
    )

    @model_validator(mode="after")
    def _asks(self) -> Self:
        if self.request is None:
            raise ValueError("request is needed: what makes the program measure a point and answer with it")
        if not self.url.startswith("tcp://"):
            raise ValueError(
                f"url is '{self.url}': give a tcp:// one, for only its connections tell a late answer from "
                "that of the next pose"
            )
        if needless := [key for key in _OF_STREAMS if key in self.model_fields_set]:
            raise ValueError(
                f'{needless[0]} is of readings that keep coming, driver = "line-stream"; remove it'
            )
        return self

    def _check_stated(self, fields: frozenset[str]) -> None:
        if fields >= set(STATED):
            raise ValueError("a line gives sigma or u95, not both")


class LinePointTracker(LineStreamTracker):
    """One point a pose: nothing comes before it is asked for, and the program decides when it is stable.

    Who aims is the program, too: ``find`` has nothing to do, and who measures judges where the point is. A
    request whose answer did not come, or was not waited for, ends the link.
    """

    Config = LinePointConfig

    async def wait_fresh(self, timeout: float) -> None:
        """The link is good: there is no reading before a request."""
        self._life.require()

    async def find(self, near: Array | None, timeout: float) -> None:
        """Nothing; the program aims when it measures."""
        self._life.require()

    async def measure(self, window_s: float, max_scatter_m: float, timeout: float) -> Sample[StablePoint]:
        """The answer to a request that is sent now, in ``timeout`` s; ``window_s`` is the program's business.

        ``TRACKER_NO_TARGET`` for a point that the sender calls invalid, ``TRACKER_UNSTABLE`` for one whose
        stated standard deviation is above ``max_scatter_m``, ``DEVICE_LOST`` without an answer.
        """
        self._require_selected()
        async with self._newcomers() as found:
            asked = self._ask()
            try:
                sample = await found.next(min(timeout, self._config.silence_s))
            finally:
                if self._asked is not None:
                    waited = self._clock.now() - asked
                    self._lose("DEVICE_LOST", f"the point that was asked for did not come in {waited:.1f} s")
        self._life.require()
        if sample is None or sample.value.point is None or self._newest is None:
            status = "" if sample is None else sample.value.status
            raise error("TRACKER_NO_TARGET", f"{self.name}: {status}")
        sigma_m = self._newest.sigma_m
        if sigma_m is not None and sigma_m > max_scatter_m:
            raise error(
                "TRACKER_UNSTABLE",
                f"{self.name} states a standard deviation of {1e3 * sigma_m:.3f} mm for its point; the limit "
                f"is {1e3 * max_scatter_m:.3f} mm",
            )
        point = StablePoint(
            sample.value.point, 0.0, 1, 2.0 * sample.dt, *self._air(), (), sigma_m, sample.value.rotation
        )
        return Sample(point, sample.t, sample.dt, sample.seq)

    def _ask(self) -> float:
        asked = self._asked = self._clock.now()
        if self._link is not None and self._config.request is not None:
            self._link.write(self._config.request.encode())
        return asked

    async def _first_line(self) -> None:
        """There is none yet."""

    async def _run(self, link: Link) -> None:
        """Nothing is asked for but points of poses."""
