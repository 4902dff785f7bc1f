"""References and updates of bumped tools on the wire in real time, beside the twin's truth.

``python -m bench.laser_height_wire [COUNT] [CELL]... [--busy] [--keep FILE] [--bind 127.0.54.2]``.
Each time twin and daemon begin anew with beams elsewhere; the tool is bumped after the reference. The COUNT
runs, 7 minutes each, go round the cells, which are named as in ``bench.laser_height``. ``--busy`` has a
program beside them that uses a whole core. With ``--keep FILE`` a bench that was ended goes on where it was.
Printed are the errors, the coverage of the stated 95 % and 99 % for point, height and tilt, and how many are
outside 99 %: at most one of each of 20 may be.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench._laser_fixture import scenario
from bench._laser_tally import Tally
from bench.lateness import busy_programs
from fakes.twin.control import ask
from tests.kit.wire_cell import WireCell

LIMIT_S = 900.0
CELLS = ("round-14", "round-30", "flat-14", "flat-30")
AUTO = """
accept = { auto = true }
[cell.job.laser-update]
accept = { auto = true }
"""


class _Cell(WireCell):
    """A cell whose operator confirms what is asked: there is no board to move."""

    def move_board(self) -> None: ...


def one(folder: Path, bind: str, kind: str, seed: int, tally: Tally) -> None:
    """One reference and one update in a cell of its own."""
    rng = np.random.default_rng([seed, 78])
    end, sigma = kind.split("-")
    cell = _Cell(folder, bind, scenario(end, 1e-6 * float(sigma), seed) + AUTO)
    try:
        cell.start_twin()
        cell.start_daemon()
        if _done(cell, "laser-reference", tally) is None:
            return
        shift, turn = rng.uniform(-1e-3, 1e-3, 3), rng.uniform(-8e-3, 8e-3, 2)
        ask(folder, {"do": "tool", "bend": [*shift.tolist(), *turn.tolist(), 0.0]})
        began = time.monotonic()
        answer = _done(cell, "laser-update", tally)
        if answer is None:
            return
        tally.seconds.append(time.monotonic() - began)
        passes = cell.runs()[-1].path / "passes.jsonl"
        tally.ways.append(passes.read_text("utf-8").count("\n"))
        tally.take(answer["result"], ask(folder, {"do": "truth"})["T_flange_tool"])
        if not answer["inputs"].get("update", {}).get("committed"):
            tally.refused.append("; ".join(answer["reasons"]))
    finally:
        cell.stop()


def _done(cell: WireCell, job: str, tally: Tally) -> dict[str, Any] | None:
    """The result of a job that came to an answer."""
    run_id = cell.start_job(job)
    end = cell.wait_for_end(LIMIT_S)
    folder = next(r for r in cell.runs() if r.run_id == run_id)
    result = folder.read_result() or {}
    if end["outcome"] == "complete" and result.get("result") is not None:
        return result
    tally.failed.append(f"{job}: {(end.get('error') or {}).get('text') or end['outcome']}")
    return None


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("cells", nargs="*", default=CELLS, help="such as round-14 or flat-30")
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--keep", type=Path, help="file of runs: new ones are added, old ones not run")
    parser.add_argument("--bind", default="127.0.54.2")
    options = parser.parse_args()
    kept = {kind: Tally.of_file(options.keep, kind) if options.keep else {} for kind in options.cells}
    tally = Tally()
    with busy_programs(int(options.busy)):
        for seed in range(options.first, options.first + options.count):
            kind = options.cells[seed % len(options.cells)]
            own = kept[kind].get(seed)
            if own is None:
                own = Tally()
                with tempfile.TemporaryDirectory() as folder:
                    one(Path(folder), options.bind, kind, seed, own)
                if options.keep:
                    own.keep(options.keep, kind, seed)
            tally.add(own)
            told = f"z off {1e6 * float(own.point[0][2]):.0f} um" if own.point else "; ".join(own.failed)
            print(f"{seed}: {kind}, {told}", flush=True)
    print("\n".join(tally.lines()))
    outside = {name: tally.outside(name, 0.99) for name in ("point", "height", "tilt")}
    print("outside the stated 99 %: " + ", ".join(f"{name} {n}" for name, n in outside.items()))
    good = bool(tally.point) and not tally.failed and max(outside.values()) <= 1
    print(f"at most one of each outside, and all done: {'yes' if good else 'NO'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
