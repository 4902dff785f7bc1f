"""Faults of a cell, put in one after the other: what ``check`` finds, how the job ends, and what is so.

``python -m bench.told_faults [--virtual] [--bind 127.0.0.74] [WORD]...``: a row a fault. ``check`` is the
finding of ``cellward check`` that tells of it, with the sections that real devices would have; the rows on
the wire ask ``cellward check --probe``. ``end`` is the job's end, its error, or what its result warns of. A
small delay that nothing finds is counted in what every run states of its contacts (``contact_95_m``).
``truth`` is how many items it says that it has picked, how many the gripper truly took, and how far the tool
truly was beside them; a job that ended by an error has no result. Wanted is the right finding or error of
each row, and never a wrong result without a word. The rows on the wire (two senders with one identifier exist
on a bus alone) have twin and daemon as processes; ``--virtual`` leaves them out. With WORDs only faults that
have one of them.
"""

import argparse
import logging
import sys
import tempfile
import textwrap
import time
from collections.abc import Sequence
from pathlib import Path

from tests.kit.told_faults import Row, Told
from tests.kit.told_faults_rows import ROWS
from tests.kit.told_faults_wire import wire_rows

WIDE = 104


def shown(row: Row, told: Told, seconds: float) -> list[str]:
    """The lines of a row."""
    good = row.wanted.met(told)
    end = told.outcome + (f", {told.code}" if told.code else "")
    if warned := [code for code in told.warned if code == row.wanted.warning]:
        end += f", warns {', '.join(warned)}"
    none = "nothing: counted in contact_95_m" if row.wanted.counted else "-"
    finding = row.wanted.finding(told) or (none if row.wanted.check is None else "NOTHING")
    parts = (("check", finding), ("end", end), ("truth", told.truth))
    lines = [f"{row.fault} ({row.where}): {'as wanted' if good else 'NOT AS WANTED'}   ({seconds:.0f} s)"]
    for name, text in parts:
        lines += textwrap.wrap(text, WIDE, initial_indent=f"  {name:6s}", subsequent_indent=" " * 8)
    return lines


def play(rows: Sequence[Row]) -> int:
    """How many rows are not as wanted."""
    bad = 0
    for row in rows:
        begun = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            told = row.play(Path(folder))
        print("\n".join(shown(row, told, time.perf_counter() - begun)), flush=True)
        bad += not row.wanted.met(told)
    return bad


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", help="only faults that have one of them")
    parser.add_argument("--virtual", action="store_true", help="without the rows on the wire")
    parser.add_argument("--bind", default="127.0.0.74", help="address of the twin on the wire")
    options = parser.parse_args()
    logging.disable(logging.ERROR)

    def chosen(rows: Sequence[Row]) -> list[Row]:
        return [row for row in rows if not options.words or any(word in row.fault for word in options.words)]

    bad = play(chosen(ROWS))
    if not options.virtual:
        with wire_rows(options.bind) as rows:
            bad += play(chosen(rows))
    print(f"\nas wanted: {'NO' if bad else 'yes'}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
