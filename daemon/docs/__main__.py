"""``python -m daemon.docs`` writes what is stale; with ``--check`` it only names it (exit code 1)."""

import argparse
import sys

from daemon.docs import ROOT, generated, stale
from procedures.registry import JOBS


def main() -> int:
    parser = argparse.ArgumentParser(prog="daemon.docs", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args().check
    pages = generated(JOBS)
    names = stale(pages)
    for name in names:
        sys.stderr.write(f"{name} {'is stale' if check else 'written'}\n")
        if not check:
            (ROOT / name).write_text(pages[name], "utf-8")
    return 1 if check and names else 0


sys.exit(main())
