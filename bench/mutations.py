"""Mutations of configurations, data sets, ROBOT files, run folders and requests: how does each end?

``python -m bench.mutations [COUNT] [SEED] [KIND ...]``: the same seed makes the same mutations. Each is run
as a shell would run it, in this process. Requests go to the control socket and the Modbus server: exit 0
means answered, 2 refused, 3 closed without an answer. A line a kind: how many ended with which exit code, how
many with a traceback or error 9001, and how many passed with an answer that is grossly another one than that
of the untouched data. Exit code 1 when there is any of the last three. The longest one is
told in seconds: of the processor for a command, so that a busy machine accuses none, of the clock for a
request.
"""

import argparse
import contextlib
import io
import json
import os
import random
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

from bench._mutate import mutate_file, mutate_tree
from bench._mutated import Case, cases
from bench._requests import Answers, control_requests, modbus_requests
from daemon.cli import main as cellward

COUNT, SEED = 2000, 1
LONG_S = 20.0
CODES = (0, 1, 2, 3, 4)
# In what a command says: a defect of ours, or a word of Python. A folder of 19:00:1x has 9001 in its name.
BAD = ("Error 9001", "Traceback", "Warning:")
REQUESTS: dict[str, Callable[[Path, int, int], Answers]] = {
    "control requests": control_requests,
    "modbus requests": modbus_requests,
}


@dataclass
class Tally:
    """What became of the mutations of one kind."""

    codes: Counter[int] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    nonsense: list[str] = field(default_factory=list)
    longest: float = 0.0


@dataclass(frozen=True)
class Ran:
    """How one command ended."""

    code: int
    out: str
    err: str
    seconds: float


def run(words: tuple[str, ...], config: Path) -> Ran:
    """``cellward WORDS`` in this process."""
    out, err, began = io.StringIO(), io.StringIO(), time.process_time()
    environment = {"CELLWARD_CONFIG": str(config), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with (
        patch.object(sys, "argv", ["cellward", *words]),
        patch.dict(os.environ, environment),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("always")
        try:
            code = cellward()
        except BaseException as exc:  # what a shell would show as a traceback
            if isinstance(exc, KeyboardInterrupt):
                raise
            code = 99
            err.write(f"Traceback: {type(exc).__name__}: {exc}")
    return Ran(code, out.getvalue(), err.getvalue(), time.process_time() - began)


def judge(case: Case, ran: Ran, untouched: Ran, tally: Tally, what: str) -> None:
    """Count one mutation."""
    tally.codes[ran.code] += 1
    tally.longest = max(tally.longest, ran.seconds)
    bad = [line for line in _ours(ran.err) if any(sign in line for sign in BAD)]
    if bad or ran.code not in CODES or ran.seconds > LONG_S:
        told = bad[0] if bad else ran.err.strip()[-300:]
        tally.faults.append(f"{what}: exit {ran.code} in {ran.seconds:.1f} s: {told}")
    elif ran.code in (2, 3, 4) and "Error" not in ran.err:
        tally.faults.append(f"{what}: exit {ran.code} without a sentence: {ran.err.strip()[-300:]}")
    elif ran.code == 0 and case.answer is not None:
        far = case.answer(untouched.out, ran.out)
        if far is not None:
            tally.nonsense.append(f"{what}: {far}")


def _ours(err: str) -> list[str]:
    """Its lines without those of the command itself that warn."""
    return [line for line in err.splitlines() if not line.startswith("Warning:")]


@contextlib.contextmanager
def copy_of(folder: Path) -> Iterator[Path]:
    """A copy that is thrown away."""
    with tempfile.TemporaryDirectory() as name:
        yield Path(shutil.copytree(folder, Path(name) / folder.name, symlinks=True))


def mutations(case: Case, count: int, seed: int, tally: Tally) -> None:
    """Run ``count`` mutations of one kind."""
    untouched = run(case.words(case.folder), case.config(case.folder))
    if untouched.code not in (0, 1):
        raise SystemExit(f"{case.name}: the untouched one ends with {untouched.code}: {untouched.err}")
    for k in range(count):
        rng = random.Random(f"{seed} {case.name} {k}")
        with copy_of(case.folder) as folder:
            file = folder / rng.choice(case.files)
            how: Callable[..., str] = mutate_tree if rng.random() < case.by_value else mutate_file
            what = f"{case.name} {k}: {file.name}: {how(file, rng)}"
            ran = run(case.words(folder), case.config(folder))
            judge(case, ran, untouched, tally, what)


Measured = Iterator[tuple[str, Tally]]


def measure(count: int, seed: int, folder: Path, names: tuple[str, ...] = ()) -> Measured:
    """``count`` mutations dealt evenly over the kinds (those in ``names``, or all), kind by kind."""
    asked = [name for name in REQUESTS if name in names or not names]
    files = tuple(name for name in names if name not in REQUESTS)
    found = cases(folder, files) if files or not names else []
    kinds = len(found) + len(asked)
    shares = [count // kinds + (n < count % kinds) for n in range(kinds)]
    for case, share in zip(found, shares, strict=False):
        tally = Tally()
        mutations(case, share, seed, tally)
        yield case.name, tally
    for name, share in zip(asked, shares[len(found) :], strict=True):
        answers = REQUESTS[name](folder / name, share, seed)
        yield name, Tally(answers.codes, answers.faults, longest=answers.longest)


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.mutations", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("count", type=int, nargs="?", default=COUNT)
    parser.add_argument("seed", type=int, nargs="?", default=SEED)
    parser.add_argument("kinds", nargs="*", help="such as laser or 'modbus requests'; all without")
    options = parser.parse_args(words)
    heads = "".join(f"exit {c:<3}" for c in CODES)
    print(f"{'kind':<22}{heads}faults  nonsense  longest s", flush=True)
    wrong = False
    with tempfile.TemporaryDirectory() as folder:
        for name, tally in measure(options.count, options.seed, Path(folder), tuple(options.kinds)):
            codes = "".join(f"{tally.codes[c]:<8}" for c in CODES)
            print(f"{name:<22}{codes}{len(tally.faults):<8}{len(tally.nonsense):<10}{tally.longest:.1f}")
            lines = [*tally.faults, *tally.nonsense]
            print("".join(f"    {line}\n" for line in lines), end="", flush=True)
            wrong = wrong or bool(lines)
    return 1 if wrong else 0


def answer_of(text: str) -> Any:
    """The ``result`` of a document on stdout."""
    return json.loads(text).get("result")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
