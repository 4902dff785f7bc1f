"""The life of one link: good until something breaks it, and everybody who waits is told what did.

What keeps it going, a task that polls or reads, lives and ends with it.
"""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import CellError, error
from cell.own_delay import busy_words
from cell.samples import Sample, Stream

T = TypeVar("T")

# The meaning of ``time_offset_s``, the same for every device.
TIME_OFFSET = "Subtracted from every stamp, s: positive when samples are stamped later than they were taken"


class Life:
    """``begin`` at each opening, ``lose`` at the first failure, ``end`` when the device is closed; what ended
    the link is kept until it is opened again."""

    def __init__(self, name: str, clock: Clock) -> None:
        self._name, self._clock = name, clock
        self._failure: CellError | None = error("DEVICE_LOST", f"{name} is not connected")
        self._lost: asyncio.Future[CellError] | None = None
        self._work: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """The link is being opened."""
        self._failure = None
        self._lost = asyncio.get_running_loop().create_future()

    def lose(self, failure: CellError) -> bool:
        """The link is broken; False when it was already."""
        if self._failure is not None:
            return False
        self._failure = failure
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(failure)
        return True

    def keep_going(self, work: Coroutine[Any, Any, None], what: str) -> None:
        """Run ``work`` from now on. If it fails for no reason of the link that is a defect, and as nobody
        watches the device any more, the link is lost."""
        self._work = asyncio.create_task(work, name=f"{self._name} {what}")
        self._work.add_done_callback(self._note_end)

    def stop_work(self) -> None:
        """Whatever it waits for will not come."""
        if self._work is not None:
            self._work.cancel()

    async def end(self) -> None:
        """The device is closed by us: the link is lost, and its work is over when this returns."""
        # Lost first: a reply that comes with the cancellation suppresses it (asyncio.wait_for before 3.12).
        self.lose(error("DEVICE_LOST", f"{self._name} was closed"))
        work, self._work = self._work, None
        if work is not None:
            work.cancel()
            await asyncio.wait([work])

    def _note_end(self, work: asyncio.Task[None]) -> None:
        if not work.cancelled() and (failure := work.exception()) is not None:
            self.lose(error("INTERNAL", f"{work.get_name()}: {failure!r}"))

    @property
    def good(self) -> bool:
        return self._failure is None

    @property
    def failure(self) -> CellError | None:
        """What broke the link; a new error each time, as it may be raised often."""
        return None if self._failure is None else error(self._failure.name, self._failure.detail)

    def require(self) -> None:
        """Raise what broke the link."""
        if (failure := self.failure) is not None:
            raise failure

    async def wait_lost(self) -> Exception:
        """Block while the link is good; return what broke it."""
        if self._lost is None:
            return error("DEVICE_LOST", f"{self._name} was never opened")
        return await asyncio.shield(self._lost)

    async def wait_for(self, awaited: asyncio.Future[Any], timeout: float | None = None) -> None:
        """Return when ``awaited`` is done or the time (s) is over; raise what breaks the link before."""
        self.require()
        either = [awaited] if self._lost is None else [awaited, self._lost]
        await asyncio.wait(either, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
        self.require()

    async def wait_fresh(self, stream: Stream[Any], timeout: float, offset_s: float = 0.0) -> None:
        """Return when a sample taken wholly after the call has arrived, else ``DEVICE_LOST``.

        ``offset_s`` was subtracted from the stamps, for what happens before a sample is taken.
        """
        asked = self._clock.now()
        fresh: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        def look(sample: Sample[Any]) -> None:
            if sample.t + offset_s - sample.dt >= asked and not fresh.done():
                fresh.set_result(None)

        undo = stream.subscribe(look)
        try:
            await self.wait_for(fresh, timeout)
        finally:
            undo()
        if not fresh.done():
            last, now = stream.last(), self._clock.now()
            newest = (
                "there is none yet" if last is None else f"the last is {now - last.t - offset_s:.3f} s old"
            )
            raise error(
                "DEVICE_LOST",
                f"{self._name} gave no fresh sample in {timeout:g} s; {newest}{busy_words(now)}",
            )


class LinkedDevice:
    """What every device with a :class:`Life` does alike."""

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self._clock = clock
        self._life = Life(name, clock)
        self._identity: Identity | None = None

    async def identify(self) -> Identity:
        """Who the device said it is when it was opened; a twin's serial begins with 9999."""
        return self._opened(self._identity)

    async def wait_lost(self) -> Exception:
        """Block while the link is good; return what broke it."""
        return await self._life.wait_lost()

    def _opened(self, part: T | None) -> T:
        """``part``, which :meth:`open` sets; raises what broke the link, and while it is still connecting."""
        self._life.require()
        if part is None:
            raise error("DEVICE_LOST", f"{self.name} is still connecting")
        return part


class SampledDevice(LinkedDevice):
    """A device that sends samples.

    ``samples`` are those that tell whether the device is fresh, ``offset_s`` what is subtracted from their
    stamps.
    """

    def __init__(self, name: str, clock: Clock, samples: Stream[Any], offset_s: float = 0.0) -> None:
        super().__init__(name, clock)
        self._samples, self._offset_s = samples, offset_s

    async def wait_fresh(self, timeout: float) -> None:
        """Return when a sample taken after the call has arrived, else ``DEVICE_LOST``."""
        await self._life.wait_fresh(self._samples, timeout, self._offset_s)
