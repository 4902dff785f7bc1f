"""Whole runs on the wire, recorded, and played to the drivers again: is the result the same?

    python -m bench.replay [JOB]... [--bind 127.0.53.9]

Twin and daemon run the job as processes and record every byte (``[cell] record = true``). Then the same job
runs on virtual time in this process, with the drivers connected to the recording alone. The figures of the
two results are compared one by one: how many there are, how many are not the same number, and the largest
difference, of the number itself or of the largest beside it in a list. Times of day and of solving are left
out. Of picking a second line tells how far the set-points of the two are apart.
"""

import argparse
import tempfile
import time
from pathlib import Path

from bench.hiccups import SCENES
from tests.kit.picks_compared import compare_picks
from tests.kit.replayed import as_replayable, compared, record, replay


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=", ".join(SCENES))
    parser.add_argument("--bind", default="127.0.53.9")
    options = parser.parse_args()
    if unknown := sorted(set(options.jobs) - set(SCENES)):
        parser.error(f"no job '{unknown[0]}'; there is {', '.join(SCENES)}")
    print(
        f"{'job':22}{'run':>8}{'recorded':>12}{'replay':>9}  {'end, end of the replay':26}"
        f"{'figures':>8}{'not equal':>10}{'most, of its list':>19}  where"
    )
    for job in options.jobs or SCENES:
        scene = SCENES[job]
        with tempfile.TemporaryDirectory(prefix="cellward-replay-") as name:
            folder = Path(name)
            begun = time.monotonic()
            text = as_replayable(scene.text)
            session = record(
                folder / "r", options.bind, text, [*scene.before, job], scene.first, scene.finish_after_s
            )
            ran, begun = time.monotonic() - begun, time.monotonic()
            size = sum(p.stat().st_size for p in (folder / "r" / "state" / "recordings").rglob("*.bin"))
            again = replay(session, folder / "p")
            played = time.monotonic() - begun
            ends = f"{session.outcomes[-1]}, {again.outcomes[-1]}"
            figures, unequal, most, where = compared(session.results[-1], again.results[-1])
            picks = compare_picks(session.state, again.state)
        print(
            f"{job:22}{ran:7.0f}s{size / 1e6:10.1f}MB{played:8.0f}s  {ends:26}"
            f"{figures:8}{unequal:10}{most:19.1e}  {where}",
            flush=True,
        )
        if picks.steps[0]:
            print(f"  {picks}", flush=True)


if __name__ == "__main__":
    main()
