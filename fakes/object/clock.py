"""The clock of the virtual loop."""

import asyncio


class VirtualClock:
    """``cell.clock.Clock`` on the running loop's time.

    Made without arguments, so that a config can name it. ``offset_s`` keeps stamps away from zero, where a
    forgotten default would go unseen.
    """

    def __init__(self, offset_s: float = 1000.0) -> None:
        self.offset_s = offset_s
        self._loop: asyncio.AbstractEventLoop | None = None

    def now(self) -> float:
        """Virtual seconds; once used on a loop, the clock stays with it."""
        if self._loop is None:
            try:
                self._loop = asyncio.get_running_loop()
            except RuntimeError:
                return self.offset_s
        return self._loop.time() + self.offset_s

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
