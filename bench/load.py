"""Who uses the cores while a job runs on the twin: processor time of each process, and waits for a core.

The shares are processor time over the time that passed, so other work on the machine changes them little.
The waits are those of the threads on a run queue within 20 ms (``/proc/PID/task/TID/schedstat``, Linux), and
show who starves whom. A thread of the benchmark's own that sleeps for 1 ms shows what the machine does.
"""

import argparse
import os
import subprocess
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from bench._expected import expect
from tests.kit.wire_cell import WireCell, calibrate_camera, pause, shipped, wait_for, wire_cell

BIND = "127.0.0.91"
LOOK_S = 0.02
LIST_S = 0.5
LIMITS_MS = (20.0, 40.0, 80.0)
SCENARIOS = {"laser-reference": "laser", "cone-capture": "hand_eye_to_hand", "belt-tracking": "picking"}


@dataclass
class Load:
    """What one process did while it was watched; times in s, waits in ms for each look."""

    used_s: float = 0.0
    waits_ms: list[float] = field(default_factory=list)

    def row(self, name: str, seconds: float) -> str:
        """The process's line of the table."""
        above = "".join(f"{sum(w > limit for w in self.waits_ms):8}" for limit in LIMITS_MS)
        longest = max(self.waits_ms, default=0.0)
        return f"{name:24}{100.0 * self.used_s / seconds:8.1f}%{above}{longest:10.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--job", default="laser-reference", choices=sorted(SCENARIOS))
    parser.add_argument("--seconds", type=float, default=20.0, help="how long to watch the job at work")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="cellward-bench-") as folder:
        first = calibrate_camera if chosen.job == "belt-tracking" else _nothing
        scenario = shipped(SCENARIOS[chosen.job])
        with wire_cell(Path(folder), BIND, scenario, first) as cell:
            cell.start_job(chosen.job)
            wait_for(cell.moving, "motion", 60.0)
            seconds, loads, late_ms = _watch(cell, chosen.seconds)
            status = cell.status()
            ended = status["job"] is None and status["last_run"]
            if not ended:
                cell.call("halt")
    print(f"{chosen.job}, watched for {seconds:.1f} s" + (f"; it ended: {ended}" if ended else ""))
    limits = "".join(f"{f'> {limit:.0f} ms':>8}" for limit in LIMITS_MS)
    print(f"{'process':24}{'CPU':>9}{limits}{'longest':>10}")
    for name, load in sorted(loads.items(), key=lambda item: -item[1].used_s):
        print(load.row(name, seconds))
    both = sum(load.used_s for name, load in loads.items() if name in ("twin", "daemon"))
    print(f"twin and daemon together: {100.0 * both / seconds / 2.0:.1f} % of two cores")
    print(f"a 1 ms sleeper beside them was late by at most {late_ms:.1f} ms")


def _nothing(cell: WireCell) -> None:
    """No preparation."""


def _watch(cell: WireCell, seconds: float) -> tuple[float, dict[str, Load], float]:
    """Seconds watched (fewer when the job ends), each process's load, and a plain sleeper's delay, ms."""
    loads: defaultdict[str, Load] = defaultdict(Load)
    used: dict[int, float] = {}
    waited: dict[int, int] = {}
    begun = time.monotonic()
    names: dict[int, str] = {}
    listed = -1.0
    with _Sleeper() as sleeper:
        while (passed := time.monotonic() - begun) < seconds:
            if passed - listed > LIST_S:
                listed = passed
                if cell.status()["job"] is None:
                    break
                names = dict(_processes(cell))
                _add_used(names, used, loads)
            for pid, name in names.items():
                _add_waits(pid, loads[name], waited)
            pause(LOOK_S)
        _add_used(names, used, loads)
    return time.monotonic() - begun, dict(loads), 1e3 * sleeper.late_s


def _processes(cell: WireCell) -> Iterator[tuple[int, str]]:
    """Pid and name of every process of the cell."""
    for process, name in ((cell.twin, "twin"), (cell.daemon, "daemon")):
        pid = expect(subprocess.Popen, process).pid
        yield pid, name
        for child in psutil.Process(pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                yield child.pid, f"{name}: {_child_name(' '.join(child.cmdline()))}"


def _child_name(command: str) -> str:
    for word, name in (
        ("vision_child", "vision child"),
        ("motion_child", "motion child"),
        ("resource_tracker", "resource tracker"),
    ):
        if word in command:
            return name
    return "solver or camera"


def _add_used(names: dict[int, str], used: dict[int, float], loads: dict[str, Load]) -> None:
    for pid, name in names.items():
        with suppress(psutil.NoSuchProcess):
            times = psutil.Process(pid).cpu_times()
            now = times.user + times.system
            loads[name].used_s += now - used.get(pid, now)
            used[pid] = now


def _add_waits(pid: int, load: Load, waited: dict[int, int]) -> None:
    """The wait of each thread of ``pid`` since the last look."""
    with suppress(OSError):
        for tid in map(int, os.listdir(f"/proc/{pid}/task")):
            with suppress(OSError, ValueError):
                text = Path(f"/proc/{pid}/task/{tid}/schedstat").read_text("ascii")
                now = int(text.split()[1])
                load.waits_ms.append((now - waited.get(tid, now)) / 1e6)
                waited[tid] = now


class _Sleeper:
    """A thread that sleeps for 1 ms again and again, and keeps by how much it was late at most."""

    def __init__(self) -> None:
        self.late_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "_Sleeper":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        before = time.monotonic()
        while not self._stop.is_set():
            pause(0.001)
            now = time.monotonic()
            self.late_s = max(self.late_s, now - before - 0.001)
            before = now


if __name__ == "__main__":
    main()
