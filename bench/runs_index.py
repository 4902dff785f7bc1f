"""Listing the newest runs of a cell that has many: by the folders' names, beside opening every folder.

``python -m bench.runs_index [RUNS]`` makes the folders in a temporary one and prints a table.
Each way runs in a process of its own, so that its peak memory is its own.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cell.store.runs import END_SCHEMA, RUN_SCHEMA, list_runs

NEWEST = 20
CONFIG_VALUES = 300  # run.json carries the configuration: about 10 kB


def make(runs: Path, number: int) -> None:
    """``number`` ended runs, a minute apart."""
    begin = datetime(2026, 1, 1, tzinfo=UTC)
    config = {f"key_{i}": [i * 0.1, "text"] for i in range(CONFIG_VALUES)}
    end = json.dumps({"schema": END_SCHEMA, "outcome": "complete", "verdict": "pass"})
    for run_id in range(1, number + 1):
        started = begin + timedelta(minutes=run_id)
        folder = runs / f"{started:%Y%m%dT%H%M%SZ}_laser-check_{run_id}"
        folder.mkdir()
        info = {"schema": RUN_SCHEMA, "run_id": run_id, "job": "laser-check"}
        (folder / "run.json").write_text(json.dumps({**info, "started": str(started), "config": config}))
        (folder / "end.json").write_text(end)


def measure(runs: Path, way: str) -> None:
    """One way of listing, in this process: prints what it took as JSON."""
    begin = time.perf_counter()
    found = list_runs(runs, NEWEST) if way == "names" else list_runs(runs)[-NEWEST:]
    for run in found:
        run.read_end()
    taken = time.perf_counter() - begin
    peak_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"s": taken, "MB": peak_kb / 1024, "newest": found[-1].run_id}))


def main(number: int) -> None:
    with tempfile.TemporaryDirectory(prefix="cellward-runs-") as folder:
        make(Path(folder), number)
        print(f"newest {NEWEST} of {number} runs")
        print(f"{'way':<28}{'time':>10}{'peak memory':>14}")
        for way, told in (("names", "names of the folders"), ("folders", "every folder opened")):
            command = [sys.executable, "-m", "bench.runs_index", folder, way]
            done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path.cwd())
            figures = json.loads(done.stdout)
            assert figures["newest"] == number
            print(f"{told:<28}{figures['s']:>8.2f} s{figures['MB']:>11.0f} MB")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        measure(Path(sys.argv[1]), sys.argv[2])
    else:
        main(int(sys.argv[1]) if len(sys.argv) == 2 else 100_000)
