"""How late the loop and the arm's state are while each job runs, beside programs that use a whole core each.

``python -m bench.lateness [JOB]... [--busy 2] [--bind 127.0.53.7]``. The figures are those that every run
leaves in its journal: the delay of a wake-up that the loop asks for every 50 ms, and the age of the arm's
state when a sample is judged or the newest one is asked for. The busy programs are begun with niceness 0 in
sessions of their own, since the kernel shares the cores between sessions first.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bench.hiccups import RUN_LIMIT_S, SCENES, accept_proposed
from cell.errors import CellError
from cell.store.runs import load_run
from tests.kit.wire_cell import pause, wire_cell

# It ends with the bench, however that ends.
BUSY = "import ctypes, signal; ctypes.CDLL(None).prctl(1, signal.SIGKILL)\nwhile True: pass"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=", ".join(SCENES))
    parser.add_argument("--busy", type=int, default=2, help="programs that use a whole core each")
    parser.add_argument("--bind", default="127.0.53.7")
    options = parser.parse_args()
    if unknown := sorted(set(options.jobs) - set(SCENES)):
        parser.error(f"no job '{unknown[0]}'; there is {', '.join(SCENES)}")
    print(f"beside {options.busy} busy programs; times in ms")
    quantiles = f"{'n':>7}{'p50':>8}{'p99':>8}{'p99.9':>8}{'longest':>9}"
    print(f"{'':20} {'loop lag':^41} {'age of the state':^41}")
    print(f"{'job':20} {quantiles} {quantiles}  end", flush=True)
    with busy_programs(options.busy):
        for job in options.jobs or SCENES:
            end, timing = one_run(job, options.bind)
            rows = " ".join(_row(timing.get(name)) for name in ("loop_lag", "state_age"))
            print(f"{job:20} {rows}  {end}", flush=True)


def one_run(job: str, bind: str) -> tuple[str, dict[str, Any]]:
    """One run of ``job`` in a cell of its own: how it ended, and what its journal says of the timing."""
    scene = SCENES[job]
    with (
        tempfile.TemporaryDirectory(prefix="cellward-lateness-") as folder,
        wire_cell(Path(folder), bind, scene.text, scene.first, limits={}) as cell,
    ):
        for before in scene.before:
            cell.start_job(before)
            accept_proposed(cell, cell.wait_for_end(RUN_LIMIT_S)["run_id"])
        run_id = cell.start_job(job)
        if scene.finish_after_s is not None:
            pause(scene.finish_after_s)
            with suppress(CellError):
                cell.call("finish")
        last = cell.wait_for_end(RUN_LIMIT_S)
        run = load_run(Path(cell.config()["cell"]["state_dir"]) / "runs", run_id)
        timing = next((e for e in run.read_journal() if e.get("event") == "timing"), {})
        again = last["steps_taken_again"]
        why = (
            f" {last['error']['name']}: {last['error']['text']}"
            if last["error"]
            else f", {again} steps again"
        )
        return last["outcome"] + why, timing


def _row(summary: dict[str, float] | None) -> str:
    if summary is None:
        return f"{'-':>41}"
    p50, p99, p999, longest = (1e3 * summary[key] for key in ("p50_s", "p99_s", "p999_s", "max_s"))
    return f"{summary['n']:7.0f}{p50:8.2f}{p99:8.2f}{p999:8.2f}{longest:9.2f}"


@contextmanager
def busy_programs(count: int) -> Iterator[None]:
    """``count`` processes that use a core each, in sessions of their own."""
    programs = [subprocess.Popen([sys.executable, "-c", BUSY], start_new_session=True) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


if __name__ == "__main__":
    main()
