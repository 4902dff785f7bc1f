"""Which part of a cell has changed: tool bent, camera moved, a joint's zero lost, or nothing.

``python -m bench.cross_check [RUNS] [--setup eye-to-hand|eye-in-hand] [--touch] [--tool MM]``: data sets,
20 of each without RUNS. A UR10e whose links are off by 0.2 mm and 0.3 mrad, or as its maker calibrates one,
0.06 mm and 0.09 mrad, with errors of gears and sag, the same in both captures; 40 poses each (of a camera on
the flange 100, of which 60 or so show the target) with 0.2 px a corner, 0.03 mm and 0.05 mrad of the flange;
the tool's point in the beams to 0.015 mm per axis. Injected: 0.7 mm of the tool's point, 1 mm and 1 mrad of
the camera, 1 mrad of the zero of a joint, in directions of chance. With a fixed camera it is one of the
joints 1 to 5: that of joint 6 turns a target that is put anew, and a tool on its axis, about that axis, and
shows nowhere. With a camera on the flange it is one of the joints 2 to 6: that of joint 1 shows in the beams
alone, as a bent tool does. ``--touch``: a camera on the flange and no beams, the tool's point over four
corners of a board instead, brought there to 0.1 mm per axis. ``--tool`` is by how much a tool is bent.

``--twin RUNS``: the same of the whole product, in the twin (:mod:`bench._cross_twin`). Each run draws a
cell as a rehearsal does (arm, lens, print, mounting, beams and boards around the cell of the demo's cross
check, in its real world) and plays the jobs on virtual time: a capture of 40 poses and a laser reference,
then, in a cell that is started again after the fault, laser-check and a capture of a board that lies
elsewhere, by a lens that temperature has changed, by as much as the check itself takes for usual; the cross
check judges the runs. A tool is bent at the flange, a camera moved and turned in directions of chance, a zero
lost of one of the joints 2 to 6.
``--faults`` says which: ``usual`` as above, ``small`` about half of it, ``large`` twice, ``base`` the zero
of joint 1, which cannot be told. ``--touch``: a touch test of now in place of the beams, with tools bent by
1.5 mm. With ``--keep FILE`` a bench that was ended goes on where it was.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench._cross_twin import CANNOT_TELL, FAULTS, NEVER, Told, faults_of, played
from calibration.hand_eye.problem import Setup
from tests.kit.cross_check_scene import TOOL_M, checked

ARMS = {"0.20": 2e-4, "0.06": 6e-5}
PARTS = ("none", "tool", "camera", "joint")
NAMES = ("none", "tool", "camera", "joint zero", "cannot-tell")
RIGHT = {"none": "none", "tool": "tool", "camera": "camera", "joint": "joint zero"}
SHARE = 0.95
POSES: dict[Setup, int] = {"eye-to-hand": 40, "eye-in-hand": 100}  # of which a camera on the flange sees 60 %


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=20)
    parser.add_argument("--setup", choices=("eye-to-hand", "eye-in-hand"), default="eye-to-hand")
    parser.add_argument("--arm", choices=tuple(ARMS), action="append")
    parser.add_argument("--touch", action="store_true", help="corners of a board in place of the beams")
    parser.add_argument(
        "--tool", type=float, default=1e3 * TOOL_M, metavar="MM", help="a bent tool is off by"
    )
    parser.add_argument("--twin", type=int, metavar="RUNS", help="cells of the twin, not data sets")
    parser.add_argument("--first", type=int, default=1, help="seed of the first cell; others follow it")
    parser.add_argument("--faults", choices=tuple(FAULTS), action="append", help="in the twin: usual")
    parser.add_argument("--keep", type=Path, help="file of cells: new ones are added, old ones not run")
    options = parser.parse_args()
    if options.twin is not None:
        seeds = range(options.first, options.first + options.twin)
        return in_twin(seeds, options.faults, options.keep, options.touch)
    setup: Setup = "eye-in-hand" if options.touch else options.setup
    by = {"beams": not options.touch, "touch": options.touch, "tool_m": 1e-3 * options.tool}
    poses = POSES[setup]
    begun, good = time.perf_counter(), True
    how = "touched corners" if options.touch else "beams"
    print(f"{options.runs} data sets each, {setup}, with {how}; a bent tool is off by {options.tool:g} mm")
    print(f"{'arm mm':>7} {'changed':8}" + "".join(f"{name:>13}" for name in NAMES) + "   wrong joint")
    for arm in options.arm or ARMS:
        for part in PARTS:
            count, wrong = Counter[str](), 0
            for seed in range(options.runs):
                joint = seed % 5 + (setup == "eye-in-hand")
                found = checked(1000 + seed, part, joint, setup, poses, ARMS[arm], **by)
                count[found.part] += 1
                wrong += found.part == "joint zero" and (part != "joint" or found.joint != joint)
            print(
                f"{arm:>7} {part:8}" + "".join(f"{count[name]:13d}" for name in NAMES) + f"{wrong:14d}",
                flush=True,
            )
            good &= count[RIGHT[part]] >= SHARE * options.runs
    print(f"\nthe right one in at least {100 * SHARE:g} %: {'yes' if good else 'NO'}"
          f"   ({time.perf_counter() - begun:.0f} s)")  # fmt: skip
    return 0 if good else 1


def in_twin(seeds: Sequence[int], sizes: Sequence[str] | None, keep: Path | None, touch: bool = False) -> int:
    """The table of cells of the twin; 0 when each fault was found often enough, and nothing wrong named."""
    faults = faults_of(sizes or ["touch" if touch else "usual"])
    lines = keep.read_text("utf-8").splitlines() if keep is not None and keep.exists() else []
    told = [Told(**json.loads(line)) for line in lines]
    told = [one for one in told if one.touch is touch]  # a camera moved by 1 mm is a fault of both
    done = {(one.seed, one.fault) for one in told}
    for seed in seeds:
        if wanted := [fault for fault in faults if (seed, fault.name) not in done]:
            new = played(seed, wanted, touch)
            told += new
            if keep is not None:
                with keep.open("a", encoding="utf-8") as file:
                    file.writelines(one.as_json() + "\n" for one in new)
    asked = [one for one in told if one.seed in seeds and one.fault in {fault.name for fault in faults}]
    for line in twin_table(asked, [fault.name for fault in faults]):
        print(line)
    names = {one.fault for one in asked}
    shares = [np.mean([one.good for one in asked if one.fault == name]) for name in names]
    return 0 if min(shares) >= SHARE and not any(one.wrong for one in asked) else 1


def twin_table(told: Sequence[Told], faults: Sequence[str]) -> list[str]:
    """A row a fault, and each cell in which another answer came than the right one."""
    head = ("right", CANNOT_TELL, "wrong", NEVER, "size right", "CPU s")
    rows = [f"{'mm, mrad':12}{'cells':>6}" + "".join(f"{name:>13}" for name in head)]
    for name in faults:
        of = [one for one in told if one.fault == name]
        sized = [one.sized for one in of if one.sized is not None]
        counts = (
            sum(one.good for one in of),
            sum(one.named == CANNOT_TELL for one in of),
            sum(one.wrong for one in of),
            sum(one.named == NEVER for one in of),
            f"{sum(sized)} of {len(sized)}" if sized else "-",
            f"{np.mean([one.seconds for one in of]):.1f}" if of else "-",
        )
        rows.append(f"{name:12}{len(of):6}" + "".join(f"{count:>13}" for count in counts))
    for one in told:
        if not one.good:
            likely = ", ".join(f"{part} {100 * p:.1f} %" for part, p in one.probable.items() if p >= 5e-4)
            rows.append(f"  cell {one.seed}, {one.fault}: {one.named}, not {one.right}; {one.why or likely}")
    return rows


if __name__ == "__main__":
    sys.exit(main())
