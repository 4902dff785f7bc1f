"""Listing the newest runs of a cell that has many: by the folders' names, beside opening every folder.

``python -m bench.runs_index [RUNS]`` makes the folders in a temporary one and prints a table: ``cellward runs
-n 20`` as a shell runs it, with the start of the interpreter, that start alone, and the two ways of listing.
Each runs in a process of its own, so that its peak memory is its own.
"""

import hashlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from io import TextIOBase
from pathlib import Path

from bench._expected import expect
from cell.store.runs import END_SCHEMA, RESULT_FILE, RESULT_SUM, RUN_SCHEMA, list_runs

NEWEST = 20
CONFIG_VALUES = 300  # run.json carries the configuration: about 10 kB
RESULT_BYTES = 1_000_000  # a long one


def make(runs: Path, number: int) -> None:
    """``number`` ended runs, a minute apart; the newest have a result, whose sum is looked at."""
    begin = datetime(2026, 1, 1, tzinfo=UTC)
    config = {f"key_{i}": [i * 0.1, "text"] for i in range(CONFIG_VALUES)}
    end = {"schema": END_SCHEMA, "outcome": "complete", "verdict": "pass"}
    result = b" " * RESULT_BYTES
    judged = json.dumps({**end, RESULT_SUM: hashlib.sha256(result).hexdigest()})
    unjudged = json.dumps(end)
    for run_id in range(1, number + 1):
        started = begin + timedelta(minutes=run_id)
        folder = runs / f"{started:%Y%m%dT%H%M%SZ}_laser-check_{run_id}"
        folder.mkdir()
        info = {"schema": RUN_SCHEMA, "run_id": run_id, "job": "laser-check"}
        (folder / "run.json").write_text(json.dumps({**info, "started": str(started), "config": config}))
        newest = run_id > number - NEWEST
        (folder / "end.json").write_text(judged if newest else unjudged)
        if newest:
            (folder / RESULT_FILE).write_bytes(result)


def measure(runs: Path, way: str) -> None:
    """One way of listing, in this process: prints what it took as JSON."""
    begin, cpu = time.perf_counter(), time.process_time()
    found = list_runs(runs, NEWEST) if way == "names" else list_runs(runs)[-NEWEST:]
    for run in found:
        run.read_end()
    taken, cpu = time.perf_counter() - begin, time.process_time() - cpu
    peak_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"s": taken, "cpu": cpu, "MB": peak_kb / 1024, "newest": found[-1].run_id}))


def command(words: list[str], config: Path) -> tuple[str, float, float, float]:
    """What a command line of cellward prints, its time and CPU time in s, and its peak memory in MB."""
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", "import sys; from daemon.cli import main; sys.exit(main())", *words],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "CELLWARD_CONFIG": str(config)},
    )
    with expect(TextIOBase, process.stdout) as printed:
        out = printed.read()
    _, status, used = os.wait4(process.pid, 0)
    taken = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"cellward {' '.join(words)} ended with {process.returncode}")
    return out, taken, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def _all_listed(newest: int, number: int) -> None:
    if newest != number:
        raise SystemExit(f"the listing ends with run {newest} of {number}")


def main(number: int) -> None:
    with tempfile.TemporaryDirectory(prefix="cellward-runs-") as folder:
        runs, config = Path(folder) / "runs", Path(folder) / "cell.toml"
        runs.mkdir()
        config.write_text(
            f'schema = 1\n[cell]\nstate_dir = "{folder}"\ncontrol_socket = "{folder}/control.sock"\n'
        )
        make(runs, number)
        print(f"newest {NEWEST} of {number} runs")
        print(f"{'way':<34}{'time':>10}{'CPU':>10}{'peak memory':>14}")
        listing = ["runs", "-n", str(NEWEST), "--json"]
        for told, words in ((f"cellward runs -n {NEWEST}", listing), ("cellward --help", ["--help"])):
            out, taken, cpu, peak = command(words, config)
            if words is listing:
                _all_listed(json.loads(out)[-1]["run_id"], number)
            print(f"{told:<34}{taken:>8.2f} s{cpu:>8.2f} s{peak:>11.0f} MB")
        for way, told in (("names", "listing: names of the folders"), ("folders", "listing: all opened")):
            done = subprocess.run(
                [sys.executable, "-m", "bench.runs_index", str(runs), way],
                capture_output=True,
                text=True,
                check=True,
                cwd=Path.cwd(),
            )
            figures = json.loads(done.stdout)
            _all_listed(figures["newest"], number)
            print(f"{told:<34}{figures['s']:>8.2f} s{figures['cpu']:>8.2f} s{figures['MB']:>11.0f} MB")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        measure(Path(sys.argv[1]), sys.argv[2])
    else:
        main(int(sys.argv[1]) if len(sys.argv) == 2 else 100_000)
