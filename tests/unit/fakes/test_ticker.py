"""The control cycles of a twin after its loop had no core for a while."""

import asyncio

from fakes.wire.ticker import Ticker

RATE_HZ = 500.0


def test_who_asks_first_after_a_stall_finds_the_cycles_done() -> None:
    """Otherwise an answer for now is given before what the cycles of the past do."""

    async def main() -> None:
        time_s, done = 100.0, list[float]()
        ticker = Ticker(RATE_HZ, done.append, lambda: time_s)
        ticker.start()
        time_s += 0.0195
        assert ticker.catch_up() == time_s
        assert len(done) == 9
        ticker.catch_up()
        assert len(done) == 9  # once each
        ticker.stop()
        time_s += 1.0
        assert ticker.catch_up() == time_s
        assert len(done) == 9

    asyncio.run(main())
