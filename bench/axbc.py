"""A fixed camera, a target on the flange: what is found, who is blamed, and how well targets are reached.

``python -m bench.axbc [RUNS] [--observe poses|corners] [--no-joints] [--reached]``. UR10e, reported by its
nominal arm. Arms: lengths to 0.2 mm and angles to 0.3 mrad, with gears and sag; or as its maker calibrates
one (0.06 mm, 0.09 mrad). Poses have the noise 0.05 mm and 0.2 mrad; corners 0.2 px. C is known to 0.1 mm and
0.3 mrad.

First table: RMS over 60 unseen places of the distance of the target from where the file's commands should
bring it, executed by the true arm; with the given (true) hand-eye, with the published constant, through
the model, and by the way that was chosen; how often that is worse than none. Beside it, of poses, what the
best estimator is expected to leave that knows how good the arm is: ``bound`` where it is told how far C is
off as that is drawn, a length in a direction of chance, and ``stated`` where it goes by what the file states
of C, that length along each axis. ``--reached``: this table alone. Second table: how often each
part is blamed, and the share of given hand-eyes whose error is inside the stated 95 %.

``--no-joints``: the second table alone, from data without joints, also of an arm without errors and with 20
poses. ``python -m bench.no_joints`` has the uncertainty of such data.
"""

import argparse
import itertools
import json
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from bench._axbc_bound import best
from calibration.hand_eye import se3
from cell.poses import Array, from_pose6
from procedures.eye_to_hand.solve.solver import solve_axbc
from tests.kit.eye_to_hand_scene import SIGMA_C_R, SIGMA_C_T, EyeToHandScene, joints, make_scene, pose6
from tests.kit.imperfect_cell import ARM

USUAL, FACTORY = 2e-4, 6e-5
EXACT, AS_KNOWN, WRONG = (0.0, 0.0), (SIGMA_C_T, SIGMA_C_R), (5e-4, 1e-3)
WRONGS = (
    ("nothing", AS_KNOWN, EXACT),
    ("C 0.5 mm, 1 mrad", WRONG, EXACT),
    ("hand-eye 1 mm, 1 mrad", AS_KNOWN, (1e-3, 1e-3)),
)
WAYS, BLAMED = ("none", "constant", "model", "chosen"), ("none", "X", "C", "arm")
BEST = ("bound", "stated")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", nargs="?", type=int, default=20)
    parser.add_argument("--observe", choices=("poses", "corners"), default="poses")
    parser.add_argument("--no-joints", action="store_true")
    parser.add_argument("--reached", action="store_true")
    options = parser.parse_args()
    bare = options.observe == "poses"
    if not options.no_joints:
        _print_reached(options.runs, bare)
    if options.reached:
        return
    _print_blamed(options.runs, bare, not options.no_joints)


def _print_reached(runs: int, bare: bool) -> None:
    print(
        f"{'arm mm':>6}{'poses':>6} {'C off':8}"
        + "".join(f"{way:>10}" for way in (*WAYS, *(BEST if bare else ())))
        + "  mm   worse than none"
    )
    for arm, n, C_off in (
        (USUAL, 60, EXACT),
        (USUAL, 60, AS_KNOWN),
        (FACTORY, 60, AS_KNOWN),
        (USUAL, 20, AS_KNOWN),
    ):
        rows = np.array([reached(seed, arm, n, C_off, bare) for seed in range(runs)])
        rms = "".join(f"{1e3 * v:10.3f}" for v in np.sqrt(np.nanmean(rows**2, axis=0)))
        worse = int(np.sum(rows[:, 3] > rows[:, 0]))
        print(f"{1e3 * arm:6.2f}{n:6d} {_off(C_off):8}{rms}       {worse} of {len(rows)}", flush=True)
    print()


def _print_blamed(runs: int, bare: bool, with_joints: bool) -> None:
    counted = "".join(f"{name:>6}" for name in BLAMED)
    print(f"{'arm mm':>6}{'poses':>6} {'wrong':25}{counted}{'cannot-tell':>13}  inside t %  r %")
    arms = ((FACTORY, 60), (USUAL, 60)) if with_joints else itertools.product((0.0, FACTORY, USUAL), (20, 60))
    for (arm, n), (name, C_off, X_off) in itertools.product(arms, WRONGS):
        found = [judged(seed, arm, n, C_off, X_off, bare, with_joints) for seed in range(runs)]
        count = Counter(blamed for blamed, _, _ in found)
        inside = [100.0 * np.mean([f[k] for f in found]) for k in (1, 2)]
        names = "".join(f"{count[k]:>6}" for k in BLAMED) + f"{count['cannot-tell']:>13}"
        row = f"{1e3 * arm:6.2f}{n:6d} {name:25}{names}            {inside[0]:5.0f}{inside[1]:5.0f}"
        print(row, flush=True)


def reached(seed: int, arm: float, n: int, C_off: tuple[float, float], bare: bool) -> list[float]:
    """RMS (m) over unseen places, in the order of ``WAYS``, and with ``bare`` of ``BEST``."""
    rng = np.random.default_rng([seed, n, 31])
    scene = make_scene(rng, n, arm)
    Q = joints(rng, scene.X, scene.W, 60)
    wanted = se3.inverse(scene.X) @ scene.cell.true_flange(Q)
    answer = solved(scene.data_set(rng, poses=bare, C_off=C_off), wanted, Q)["result"]
    constant = se3.inverse(se3.matrices(from_pose6(answer["mean"])))
    none, by_constant = (executed(scene, X @ wanted, Q) for X in (scene.X_serving, constant))
    chosen = answer["correction"]["chosen"]
    commands = se3.matrices(from_pose6(answer["commands"]))
    by_model = executed(scene, commands, Q) if chosen == "model" else float("nan")
    by_way = {"none": none, "constant": by_constant, "model": by_model}
    expected = best(scene, arm, C_off, Q) if bare else None
    return [*by_way.values(), by_way[chosen], *([expected.drawn, expected.stated] if expected else [])]


def judged(
    seed: int,
    arm: float,
    n: int,
    C_off: tuple[float, float],
    X_off: tuple[float, float],
    bare: bool,
    with_joints: bool,
) -> tuple[str, bool, bool]:
    """Who is blamed, and whether the error of the standard is inside its stated 95 %: place, rotation."""
    rng = np.random.default_rng([seed, 32])
    scene = make_scene(rng, n, arm)
    data = scene.data_set(rng, poses=bare, C_off=C_off, X_off=X_off, with_joints=with_joints)
    answer = solved(data)["result"]
    T = se3.matrices(from_pose6(answer["T_camera_base"]))
    e, cov = se3.log(se3.inverse(T) @ se3.inverse(scene.X_serving)), np.array(answer["cov"])
    inside = [
        bool(e[p] @ np.linalg.solve(cov[p, p], e[p]) < chi2.ppf(0.95, 3)) for p in (slice(0, 3), slice(3, 6))
    ]
    return answer["blamed"], inside[0], inside[1]


def solved(data: dict[str, object], wanted: Array | None = None, Q: Array | None = None) -> dict[str, Any]:
    """The result of ``data``, with commands for the poses ``wanted`` (k, 4, 4) near ``Q`` (k, 6)."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "axbc.json").write_text(json.dumps(data), "utf-8")
        targets = None
        if wanted is not None and Q is not None:
            targets = folder / "targets.json"
            asked = {
                "schema": "cellward.axbc-targets/1",
                "targets": [pose6(T) for T in wanted],
                "q_near": Q.tolist(),
            }
            targets.write_text(json.dumps(asked), "utf-8")
        return solve_axbc(folder, targets=targets, calls=1).as_json()


def executed(scene: EyeToHandScene, commands: Array, Q: Array) -> float:
    """RMS distance (m) of the target from where it is at ``Q``, the controller being given ``commands``."""
    arrived = [ARM.inverse(se3.transforms(T), q) for T, q in zip(commands, Q, strict=True)]
    off = (scene.marker(np.array(arrived)) - scene.marker(Q))[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _off(C_off: tuple[float, float]) -> str:
    return "exact" if C_off == EXACT else f"{1e3 * C_off[0]:g}/{1e3 * C_off[1]:g}"


if __name__ == "__main__":
    main()
