"""When an arm counts as standing still: its fresh samples say so, and no samples count as moving."""

import asyncio

from cell.devices import Arm, ArmState
from cell.samples import Sample

STANDSTILL_SAMPLES = 5
STANDSTILL_SPAN_S = 0.04


async def measured_standstill(arm: Arm, timeout: float) -> bool:
    """True once the samples that arrive from now on all show rest for a short span.

    No samples count as moving. The span is one of the stamps and of the arrivals: stamps may carry a
    configured offset, so they do not tell new from old, and a backlog that is read at once shows no span.
    """
    began: tuple[float, float] | None = None  # stamp and arrival of the first sample at rest
    count = 0
    done = asyncio.Event()

    def look(sample: Sample[ArmState]) -> None:
        nonlocal began, count
        if not sample.value.at_rest:
            began, count = None, 0
            return
        arrived = arm.state.clock.now()
        began = began or (sample.t, arrived)
        count += 1
        span = min(sample.t - began[0], arrived - began[1])
        if count >= STANDSTILL_SAMPLES and span >= STANDSTILL_SPAN_S:
            done.set()

    unsubscribe = arm.state.subscribe(look)
    try:
        async with asyncio.timeout(timeout):
            await done.wait()
        return True
    except TimeoutError:
        return False
    finally:
        unsubscribe()
