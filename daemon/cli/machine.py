"""``cellward check --machine``: can this machine carry a cell? Three seconds of measuring."""

import asyncio
import os
import tempfile
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from cell import priority
from daemon.config import CellConfig
from daemon.disk_space import free_bytes, low_limit, low_text

PROBE_S = 2.0
TICK_S = 0.001
LAG_S, LAG_SOFT_S = 0.1, 0.02  # the age at which the arm's state is stale, and that of one late step
FSYNC_S = 0.05
MIN_CORES, MIN_FREE_BYTES = 4, 20 * 10**9


@dataclass(frozen=True)
class MachineFigure:
    """One figure of the machine: ``value`` in ``unit``, ``good`` within its limit, and what it means."""

    name: str
    value: float | None
    unit: str
    good: bool
    text: str


def machine(state_dir: Path, capture: int = 0) -> list[dict[str, Any]]:
    """Every figure, about three seconds; ``state_dir`` is where the runs will be written, ``capture`` what
    one capture of pictures writes, bytes (0: the cell has none)."""
    found = [_cores(), _priorities(), *_lags(), *_disk(state_dir, capture), *_settings()]
    return [asdict(one) for one in found]


def _cores() -> MachineFigure:
    count = len(os.sched_getaffinity(0))
    means = "enough" if count >= MIN_CORES else f"{MIN_CORES} let solving and pictures run beside the arm"
    return MachineFigure("cores", count, "", count >= MIN_CORES, f"{count} cores may be used: {means}")


def _priorities() -> MachineFigure:
    """Whether a thread of this process may take SCHED_RR; under the unit it is the unit's LimitRTPRIO."""
    granted: list[bool] = []

    def ask() -> None:
        with priority.real_time(priority.LOOP):
            granted.append(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR)

    _in_thread(ask)
    means = (
        "permitted to this user"
        if granted == [True]
        else "not permitted to this user; the service unit permits it, a shell seldom does (LimitRTPRIO)"
    )
    return MachineFigure("real time", float(granted == [True]), "", granted == [True], f"SCHED_RR is {means}")


def _lags() -> list[MachineFigure]:
    """How late an event loop and a bare thread wake, measured side by side."""
    loop: list[float] = []
    thread: list[float] = []
    side = threading.Thread(target=_sleep_and_note, args=(thread,))
    side.start()
    asyncio.run(_tick(loop))
    side.join()
    return [_lag("loop", "the event loop", loop), _lag("thread", "a thread", thread)]


async def _tick(late: list[float]) -> None:
    end = monotonic() + PROBE_S
    while (before := monotonic()) < end:
        await asyncio.sleep(TICK_S)
        late.append(monotonic() - before - TICK_S)


def _sleep_and_note(late: list[float]) -> None:
    end = monotonic() + PROBE_S
    while (before := monotonic()) < end:
        sleep(TICK_S)
        late.append(monotonic() - before - TICK_S)


def _lag(name: str, what: str, late: list[float]) -> MachineFigure:
    longest = max(late)
    if longest <= LAG_SOFT_S:
        means = "good"
    elif longest <= LAG_S:
        means = "single steps of a job are taken again; see what else runs here"
    else:
        means = "the arm's state would be stale and jobs would be interrupted; free this machine"
    text = f"{what} woke at most {1e3 * longest:.1f} ms late in {PROBE_S:g} s: {means}"
    return MachineFigure(f"{name} lag", longest, "s", longest <= LAG_SOFT_S, text)


def low_space(config: CellConfig) -> str | None:
    """A warning when the disk of the runs is nearly full; None while there is room."""
    folder, limit = Path(config.cell.state_dir), low_limit(config)
    free = free_bytes(folder)
    return low_text(folder, free, limit) if free < limit else None


def _disk(state_dir: Path, capture: int = 0) -> list[MachineFigure]:
    """Free space, and how long a small file takes to be safe, in ``state_dir`` or what exists of its path."""
    folder = next(p for p in (state_dir, *state_dir.parents) if p.is_dir())
    free = free_bytes(folder)
    space = MachineFigure(
        "free space",
        float(free),
        "bytes",
        free >= MIN_FREE_BYTES,
        f"{folder}: {free / 1e9:.0f} GB are free"
        + (f", {free // capture} captures of {capture / 1e6:.0f} MB" if capture else ""),
    )
    try:
        slowest = max(_fsync(folder) for _ in range(20))
    except OSError as exc:
        why = exc.strerror or str(exc)
        return [
            space,
            MachineFigure("fsync", None, "s", False, f"{folder}: not written by this user ({why})"),
        ]
    means = "good" if slowest <= FSYNC_S else "each step of a job waits for it; use a solid-state disk"
    text = f"{folder}: a small file is safe after at most {1e3 * slowest:.1f} ms: {means}"
    return [space, MachineFigure("fsync", slowest, "s", slowest <= FSYNC_S, text)]


def _fsync(folder: Path) -> float:
    with tempfile.TemporaryFile(dir=folder) as file:
        file.write(bytes(4096))
        file.flush()
        before = monotonic()
        os.fsync(file.fileno())
        return monotonic() - before


def _settings() -> list[MachineFigure]:
    """What the kernel tells of itself; a file that is not there tells nothing."""
    found = []
    governor = _read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    if governor is not None:
        good = governor == "performance"
        means = "good" if good else "the core is slow when it wakes; 'performance' keeps it fast"
        found.append(MachineFigure("governor", None, "", good, f"frequency governor '{governor}': {means}"))
    runtime = _read("/proc/sys/kernel/sched_rt_runtime_us")
    if runtime is not None:
        good = int(runtime) != 0
        means = "real time is throttled only if it takes that much" if good else "no real time is possible"
        found.append(
            MachineFigure("real-time share", None, "", good, f"sched_rt_runtime_us = {runtime}: {means}")
        )
    kernel = os.uname()
    model = "PREEMPT_RT" if "PREEMPT_RT" in kernel.version else "no PREEMPT_RT, which a cell does not need"
    found.append(MachineFigure("kernel", None, "", True, f"Linux {kernel.release}: {model}"))
    return found


def _read(path: str) -> str | None:
    try:
        return Path(path).read_text("ascii").strip()
    except OSError:
        return None


def _in_thread(call: Callable[[], None]) -> None:
    thread = threading.Thread(target=call)
    thread.start()
    thread.join()
