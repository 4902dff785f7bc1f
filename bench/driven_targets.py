"""What is stated of targets that an eye-to-hand check is driven to, on many twins of the example cell.

``python -m bench.driven_targets [TWINS] [--first SEED] [--poses N] [--turned] [--keep FILE]`` (20 twins, 20
poses). Each is the whole job on virtual time, in a twin that ``cellward rehearse`` would draw; its four
targets are listed twice, so each command is visited twice. They lie among the poses; ``--turned`` rolls them
by half a turn from these, of which ``cellward check`` warns: what is stated has to hold there as well.

First: how many arrivals are inside the 95 % stated of them, and in how many twins the worst of all is inside
the limit for the worst, with the exact 95 % intervals (arrivals of a twin share lens, print and place, so of
arrivals the interval is too short); how often each way to correct was chosen, and how often the corrected
ones were called surely nearer, and how often wrongly.

Second: the two visits of each command as given, taken as "given" and "corrected" and judged again: how often
the second ones are called surely nearer, which nothing made them, and the first ones. By two standard
deviations 2.3 % of each would be. With ``--keep FILE`` a bench that was ended goes on where it was.
"""

import argparse
import contextlib
import io
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bench.rehearsal import exact_interval
from cell.store.runs import load_run
from daemon.config import load_config
from daemon.demo.fast import run_objects
from daemon.rehearsal.objects import rehearsed_cell
from daemon.rehearsal.play import steps_of
from procedures.beside_truth import limit_of_worst
from procedures.documents import read_result
from procedures.eye_to_hand.result import AxbcResult, DrivenTargets
from procedures.eye_to_hand.solve.solver import solve_axbc
from procedures.eye_to_hand.truth import driven_truth
from tests.kit.example_cell import whole_example

JOB = "eye-to-hand-check"
TARGETS = "targets = [[0.0, 0.05, 0.6, 3.1416, 0.0, 0.0]]"
FOUR = [
    [0.0, 0.05, 0.6, 3.1416, 0.0, 0.0],
    [0.06, 0.0, 0.55, 3.1337, 0.0, 0.2222],
    [-0.05, 0.08, 0.62, 3.075, -0.0992, 0.0591],
    [0.03, 0.1, 0.58, 2.9511, 0.0, -0.0212],
]


@dataclass(frozen=True)
class Twin:
    """One run: ``shares`` of each arrival in units of its 95 %; ``better`` as the result says it, ``truly``
    as it is; ``later`` and ``earlier``: which of two equal visits were called surely nearer."""

    seed: int
    ended: str
    way: str = ""
    shares: Sequence[float] = ()
    lost: int = 0
    better: bool | None = None
    truly: bool | None = None
    later: bool | None = None
    earlier: bool | None = None
    turned: bool = False


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.driven_targets", description=__doc__)
    parser.add_argument("twins", nargs="?", type=int, default=20)
    parser.add_argument("--first", type=int, default=1, help="seed of the first; others follow it")
    parser.add_argument("--poses", type=int, default=20)
    parser.add_argument("--turned", action="store_true", help="targets rolled by half a turn from the poses")
    parser.add_argument("--keep", type=Path, help="file of twins: new ones are added, old ones not run")
    options = parser.parse_args(arguments)
    keep: Path | None = options.keep
    lines = keep.read_text("utf-8").splitlines() if keep is not None and keep.exists() else []
    twins = [twin for line in lines if (twin := Twin(**json.loads(line))).turned == options.turned]
    done = {twin.seed for twin in twins}
    for seed in range(options.first, options.first + options.twins):
        if seed in done:
            continue
        twins.append(replace(played(seed, options.poses, options.turned), turned=options.turned))
        if keep is not None:
            with keep.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(twins[-1])) + "\n")
    for line in table(sorted(twins, key=lambda twin: twin.seed)):
        print(line)


def table(twins: Sequence[Twin]) -> list[str]:
    """The figures of all twins, and those that did not end well or were outside."""
    ended = [twin for twin in twins if twin.shares]
    shares = np.array([share for twin in ended for share in twin.shares])
    worst = [max(twin.shares) / limit_of_worst(len(twin.shares)) for twin in ended]
    rows = [
        _share("arrivals inside their 95 %", int(np.sum(shares <= 1.0)), len(shares)),
        _share("twins with the worst inside", sum(share <= 1.0 for share in worst), len(worst)),
        f"{'ways chosen':36}"
        + ", ".join(f"{way} {n}" for way, n in sorted(Counter(t.way for t in ended).items())),
    ]
    if called := [twin for twin in ended if twin.better is not None]:
        nearer = [twin for twin in called if twin.better]
        rows.append(_share("corrected called surely nearer", len(nearer), len(called)))
        wrong = sum(not t.truly for t in nearer)
        rows.append(_share("called so, and truly not", wrong, len(called)))
    equal = [twin for twin in ended if twin.later is not None]
    rows.append(_share("equal visits: second called nearer", sum(bool(t.later) for t in equal), len(equal)))
    rows.append(_share("equal visits: first called nearer", sum(bool(t.earlier) for t in equal), len(equal)))
    for twin in twins:
        if not twin.shares or twin.lost:
            rows.append(f"  twin {twin.seed}: {twin.ended}, {twin.lost} not measured")
    for twin, share in zip(ended, worst, strict=True):
        if share > 1.0:
            rows.append(f"  twin {twin.seed}: the worst of {len(twin.shares)} is {share:.2f} of its limit")
    return rows


def rolled(pose: list[float]) -> list[float]:
    """``pose`` (position and rotation vector) after half a turn about its own z."""
    turned = Rotation.from_rotvec(pose[3:]) * Rotation.from_rotvec([0.0, 0.0, np.pi])
    return [*pose[:3], *turned.as_rotvec().tolist()]


def played(seed: int, poses: int, turned: bool = False) -> Twin:
    """The job in the twin ``seed``."""
    targets = [rolled(pose) for pose in FOUR] if turned else FOUR
    with tempfile.TemporaryDirectory(prefix="cellward-driven-") as name:
        folder = Path(name)
        path = whole_example(
            folder, {TARGETS: f"poses = {poses}\nmin_poses = 12\ntargets = {targets + targets}"}
        )
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            cell = rehearsed_cell(load_config(path), path, JOB, seed, folder)
            runs, _ = run_objects(cell.config, steps_of(cell))
        run_id, truth = runs[-1]
        run = load_run(Path(cell.config.cell.state_dir) / "runs", run_id)
        end, document = run.read_end() or {}, run.read_result()
        if document is None:
            return Twin(seed, f"{end.get('outcome')}: {(end.get('error') or {}).get('text')}")
        result = read_result(document)
        if not isinstance(result, AxbcResult) or (driven := result.result.driven) is None:
            return Twin(seed, str(end.get("outcome")))
        found = driven_truth(driven, truth)
        both = sorted(found.true["before"].keys() & found.true["after"].keys())
        before, after = (sum(found.true[how][k] ** 2 for k in both) for how in ("before", "after"))
        return Twin(
            seed,
            str(end.get("outcome")),
            driven.way,
            found.shares,
            len(driven.lost),
            driven.better,
            after < before if both else None,
            _called_nearer(run.path, folder, swap=False),
            _called_nearer(run.path, folder, swap=True),
        )


def _called_nearer(run: Path, folder: Path, swap: bool) -> bool | None:
    """Whether the second visits of each command as given are called surely nearer than the first; the first
    than the second where they ``swap``."""
    data = json.loads((run / "axbc.json").read_text("utf-8"))
    driven, n = data["driven"], len(FOUR)
    targets = [{**target, "corrected": target["given"]} for target in driven["targets"][:n]]
    arrivals = [
        {"target": a["target"] % n, "how": "corrected" if (a["target"] >= n) != swap else "given"}
        | {"seen": a["seen"]}
        for a in driven["arrivals"]
        if a["how"] == "given"
    ]
    data["driven"] = {"way": "constant", "targets": targets, "arrivals": arrivals, "lost": []}
    where = folder / f"equal-{swap}"
    where.mkdir()
    (where / "axbc.json").write_text(json.dumps(data), "utf-8")
    result = solve_axbc(where, calls=1)
    judged: DrivenTargets | None = result.result.driven if isinstance(result, AxbcResult) else None
    return None if judged is None else judged.better


def _share(name: str, inside: int, of: int) -> str:
    if not of:
        return f"{name:36}-"
    low, high = exact_interval(inside, of)
    return f"{name:36}{inside} of {of} ({100 * low:.1f} to {100 * high:.1f} %)"


if __name__ == "__main__":
    main(sys.argv[1:])
