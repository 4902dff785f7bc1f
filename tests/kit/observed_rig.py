"""The twin's palletizer on its wire or with its file, and the driver for it."""

import asyncio
import os
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from cell.clock import MonotonicClock
from cell.devices import ObservedArm
from drivers.observed_arm import ObservedArmConfig, ObservedArmReader
from fakes.faults.vocabulary import Switchboard
from fakes.twin.palletizer import TwinObserved
from fakes.world.palletizer.observed import ObservedPalletizer
from fakes.world.scenario import FakeAddresses, Scenario

# The port is fixed, so modules that run side by side differ by address.
HOST, PORT = f"127.0.43.{100 + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])}", 5503
CLOCK = MonotonicClock()
# A busy machine answers late; only a test of silence waits for what does not come.
QUICK = {"rest_window_s": 0.2, "poll_period_s": 0.02, "timeout_s": 3.0}


def reader(section: dict[str, Any], **more: Any) -> ObservedArmReader:
    keys = {key: value for key, value in section.items() if key != "driver"}
    made: ObservedArm = ObservedArmReader(
        "palletizer", ObservedArmConfig(**{**keys, **QUICK, **more}), MonotonicClock()
    )
    assert isinstance(made, ObservedArmReader)
    return made


@asynccontextmanager
async def palletizer(
    folder: Path, **changes: Any
) -> AsyncIterator[tuple[TwinObserved, ObservedPalletizer, Switchboard]]:
    """The scenario's arm, with less time to look around; ``by="file"`` writes joints.csv."""
    truth = Scenario.load("palletizer").world.observed
    assert truth is not None
    by = changes.pop("by", "registers")
    truth = truth.model_copy(update={"reaction_s": 0.1, "speed_rad_s": 2.0, "accel_rad_s2": 8.0, **changes})
    arm = ObservedPalletizer(truth, 1, time.monotonic())
    twin = TwinObserved(arm, FakeAddresses(observed_port=PORT, observed_by=by), HOST, folder)
    board = Switchboard()
    board.devices["palletizer"] = twin.faults
    await twin.start()
    try:
        yield twin, arm, board
    finally:
        await twin.stop()
        await asyncio.sleep(0)
