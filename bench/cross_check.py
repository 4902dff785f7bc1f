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
"""

import argparse
import sys
import time
from collections import Counter

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
    options = parser.parse_args()
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


if __name__ == "__main__":
    sys.exit(main())
