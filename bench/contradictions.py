"""Captures that contradict themselves: is the mistake named, and is no good capture accused?

``python -m bench.contradictions [INSTANCES] [--only NAME]``: 50 instances of each mistake and four times as
many good captures by default. Arms of 0, 0.06 and 0.2 mm, exact and bent boards, lenses that are exact or
0.3 % off, three plans, camera in hand and beside the arm, with and without joints. A row: how many were named
by the code that belongs to it, and what the others were answered with.
"""

import argparse
import json
import tempfile
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

from cell.errors import InputError
from procedures.hand_eye.solve.solver import solve_hand_eye
from tests.kit.contradictions import KINDS, Document, good

FREE = {"arm.accuracy", "pairs.no-rotation", "poses.order-unchecked", "observations.rejected"}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("instances", nargs="?", type=int, default=50)
    parser.add_argument("--only", action="append", choices=("good", *KINDS))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"{'mistake':24}{'of':>5}{'named':>7}   other answers")
    for name in options.only or ("good", *KINDS):
        count = options.instances * (4 if name == "good" else 1)
        told = [answer(name, seed) for seed in range(count)]
        if name == "good":
            right = sum(not one for one in told)
            others = Counter(", ".join(sorted(one)) for one in told if one)
            label = "good, not accused"
        else:
            code = KINDS[name].code
            right = sum(code in one for one in told)
            others = Counter(", ".join(sorted(one)) or "nothing" for one in told if code not in one)
            label = name
        text = "; ".join(f"{n} x {codes}" for codes, n in others.most_common())
        print(f"{label:24}{count:5}{100 * right / count:6.0f}%   {text}", flush=True)


def answer(name: str, seed: int) -> set[str]:
    """The codes that one capture is answered with."""
    rng = np.random.default_rng([seed, 31])
    kind = KINDS.get(name)
    joints = kind.joints if kind is not None and kind.joints is not None else bool(rng.integers(2))
    document = good(rng, joints)
    if kind is not None:
        kind.spoil(rng, document)
    return codes(document)


def codes(document: Document) -> set[str]:
    with tempfile.TemporaryDirectory(prefix="contradictions-") as folder:
        path = Path(folder) / "capture.json"
        path.write_text(json.dumps(document), "utf-8")
        try:
            result = solve_hand_eye(path, calls=1)
        except InputError as exc:
            front = exc.detail.removeprefix(f"{path}: ").split(": ")[0]
            return {word for word in front.replace(" or ", " ").split() if "." in word} or {front}
    found = {warning.code for warning in result.warnings}
    if result.result is None:
        found.add(f"refused {result.reasons}")
    return found - FREE


if __name__ == "__main__":
    main()
