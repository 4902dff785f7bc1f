"""What the devices of a run told in the seconds before it failed, for its report.

A device whose link was opened anew since then has told nothing of before.
"""

import asyncio
import logging
from collections.abc import Iterable, Sequence
from math import sqrt
from pathlib import Path
from typing import Any

from cell.devices import Arm, ArmState, Device, DigitalInputs, Encoder
from cell.kinds import as_kind, plays
from cell.samples import Readings, Sample
from cell.store.files import to_json, write_atomic
from cell.store.runs import LAST_SECONDS_FILE

log = logging.getLogger("cellward.engine")

SCHEMA = "cellward.last-seconds/1"
LAST_S = 5.0
MOST_ROWS = 500  # of a device; of more, every second or third is kept

_JOINTS = range(1, 7)
_ARM = (
    *((f"joint {j}", "rad") for j in _JOINTS),
    *((f"speed of joint {j}", "rad/s") for j in _JOINTS),
    ("force", "N"),
)


async def keep_last_seconds(folder: Path, devices: Iterable[Device], now: float) -> None:
    """Write ``last_seconds.json`` of a run's ``folder``. Whatever keeps it from that is logged: the end of
    the run is worth more."""
    try:
        told = last_seconds(devices, now)
        await asyncio.to_thread(write_atomic, folder / LAST_SECONDS_FILE, to_json(told))
    except Exception as exc:
        log.warning("the last seconds before %s failed are not kept: %s", folder.name, exc)


def last_seconds(devices: Iterable[Device], now: float) -> dict[str, Any]:
    """The document of ``last_seconds.json``: for each device its ``columns`` (name and unit) and ``rows``,
    the first number of which is the time of the sample, s, from ``now`` (monotonic)."""
    told = {}
    for device in devices:
        columns, rows = _told(device, now)
        if rows:
            told[device.name] = {"columns": columns, "rows": rows}
    return {"schema": SCHEMA, "devices": told}


def _told(device: Device, now: float) -> tuple[Sequence[tuple[str, str]], list[list[float]]]:
    if plays(device, Arm):
        states = _newest(as_kind(device, Arm).state, now)
        return _ARM, [[_time(s, now), *_of_arm(s.value)] for s in states]
    if plays(device, DigitalInputs):
        module = as_kind(device, DigitalInputs)
        polls = _newest(module.inputs, now)
        return [(name, "") for name in module.names], [
            [_time(s, now), *map(int, s.value.levels)] for s in polls
        ]
    if plays(device, Encoder):
        counts = _newest(as_kind(device, Encoder).counts, now)
        return [("count", "")], [[_time(s, now), s.value.count] for s in counts]
    return (), []


def _newest(stream: Readings[Any], now: float) -> list[Sample[Any]]:
    found = stream.between(now - LAST_S, now)
    return found[:: max(-(-len(found) // MOST_ROWS), 1)]


def _time(sample: Sample[Any], now: float) -> float:
    return round(sample.t - now, 6)


def _of_arm(state: ArmState) -> list[float]:
    force = sqrt(sum(float(f) ** 2 for f in state.tcp_force[:3]))
    return [round(float(v), 6) for v in (*state.q, *state.qd, force)]
