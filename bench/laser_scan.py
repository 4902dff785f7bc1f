"""Hundreds of crossed-beam measurements beside their truth: errors, coverage of what is stated, and verdicts.

``python -m bench.laser_scan [COUNT] [CELL]... [--gates] [--first SEED]``: a reference, a bump, a measurement;
with ``--gates`` then the second scan of the update, a check of the tool as it is, and one after a bump by the
size that is promised to be found. A cell is the tool's end, the arm's standard deviation of one axis in um,
``late`` when one poll of ten comes up to 40 ms late, ``replies`` when they take as long as on the wire,
``warped`` when links, gears and sag of the arm are a little off, ``short`` with the search of the demo, and
``straight`` with a tool that does not lean:
``round-14``, ``flat-30-late``, ``round-14-warped-short``. With ``--keep FILE`` a bench that was ended
goes on where it was. Scan, solver and verdicts are the jobs'; arm, beams and polls are
``bench/_laser_world.py``. Heights of the beams, bumps and all else is drawn anew each time.
``bench.laser_height`` does the same with the whole daemon on the object twin, and ``bench.laser_height_wire``
in real time: few, and slowly.
"""

import argparse
import json
import sys
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from bench._laser_tally import Tally
from bench._laser_world import DOWN, FLAT, P_REF, POINT, ROUND, Record, World, search, take
from bench.laser_height import CELLS, LATE_GAP_S, tell
from calibration.tool_frame.repeatability import stated_sigma
from cell.errors import present
from cell.poses import Array, from_pose6, to_pose6
from fakes.likely.arm import LEAN_RAD
from procedures.laser.config import LaserCheckConfig, LaserUpdateConfig, Search
from procedures.laser.judging import judge_check, judge_moved, why_not, worth_another
from procedures.laser.packed import unpacked
from procedures.laser.record import DATA_FILE, SECOND, THIRD
from procedures.laser.result import LaserAnswer, LaserResult, MovedTest, ReferenceResult
from procedures.laser.solve.solver import solve_laser
from procedures.laser.solving import compare_second, solve_new_reference

COUNT = 20
# What a factory calibration leaves changes by so much of a way near a fixture, RMS of one direction for one
# direction: 200 arms drawn as ``cellward rehearse`` draws them, over 50 mm along a beam and 25 mm down.
WARP = 2e-4
STATED_M = stated_sigma("ur10e")
T_REF = [*P_REF.tolist(), 0.0, 0.0, 0.0]
NOMINAL = {
    "R_base_flange": DOWN.as_rotvec().tolist(),
    "beams": {
        "xs": {"point": POINT.tolist(), "dir": [1.0, 0.0, 0.0]},
        "ys": {"point": POINT.tolist(), "dir": [0.0, 1.0, 0.0]},
    },
    "tool": {"id": "pin", "p_ref": P_REF.tolist(), "axis_ref": [0.0, 0.0, 1.0], "radius": ROUND.radius},
    "repeatability_m": STATED_M,
}
UPDATE, CHECK = LaserUpdateConfig().model_dump(), LaserCheckConfig().model_dump()


class NoAnswerError(Exception):
    """The solver refused what a scan gave."""


class Fixture:
    """One fixture from its reference on."""

    def __init__(self, folder: Path, cell: str, seed: int) -> None:
        kind, sigma, *more = cell.split("-")
        late = "late" in more
        lean = np.zeros(2)
        if "straight" not in more:
            lean = LEAN_RAD * np.random.default_rng([seed, 9]).standard_normal(2)
        self.folder, self.rng = folder, np.random.default_rng([seed, 77])
        self.world = World(
            seed,
            ROUND if kind == "round" else FLAT,
            1e-6 * float(sigma),
            0.1 if late else 0.0,
            "replies" in more,
            WARP if "warped" in more else 0.0,
            lean,
        )
        self.plan: Search = search(LATE_GAP_S if late else None, "short" in more)
        path, _ = self._scan("reference", 2, P_REF, NOMINAL, None)
        solved = solve_new_reference(path, {"T_flange_tool": T_REF})
        if not isinstance(solved, ReferenceResult):
            raise NoAnswerError("; ".join(solved.reasons))
        self.reference: dict[str, Any] = solved.as_json()["result"]
        self.header = {**NOMINAL, "beams": self.reference["beams"]}

    def beams_off(self) -> tuple[Array, Array]:
        """(3,) m how far the reference is off with the point that both beams fix, in the flange, and (3, 3)
        m^2 what it states."""
        across, heights = [], []
        for name, true in self.world.beams.items():
            off = np.array(self.reference["beams"][name]["point"]) - true.point
            n = np.cross(true.direction, [0.0, 0.0, 1.0])
            n /= np.linalg.norm(n)
            across.append((n, float(n @ off)))
            height = float(np.cross(n, true.direction) @ off)
            heights.append(height - self.world.first_contact(name))
        J = np.stack([n for n, _ in across] + [np.array([0.0, 0.0, 1.0])])
        off = np.linalg.solve(J, np.array([*(e for _, e in across), float(np.mean(heights))]))
        return DOWN.inv().apply(off), np.array(self.reference["cov"])[:3, :3]

    def bend(self, shift: Array, turn: Array) -> None:
        """The tool by this against the straight one."""
        self.world = self.world.bent(shift, np.array([*turn, 0.0]))

    def measure(self, name: str, T_now: list[float]) -> tuple[Path, LaserResult, Record]:
        """The data set, the judged result and the ways of a scan with the frame ``T_now``."""
        path, record = self._scan(name, 1, from_pose6(T_now).translation, self.header, self.reference)
        known = {"T_flange_tool_ref": T_REF, "T_flange_tool_last": T_now, "offset_s": 0.0}
        judged = judge_check(solve_laser(path, calls=1), known, UPDATE)
        if not isinstance(judged, LaserResult):
            raise NoAnswerError("; ".join(judged.reasons))
        return path, judged, record

    def refused(self, first: Path, found: LaserAnswer) -> str:
        """Why the frame of ``found`` is not put into effect, empty when it is."""
        known = {"T_flange_tool": T_REF, "R_base_flange": NOMINAL["R_base_flange"]}
        p = from_pose6(frame_of(found)).translation
        for name in (SECOND, THIRD):
            self._scan(f"{first.parent.name}/{name}", 1, p, self.header, self.reference)
            second = compare_second(first, found, known)
            why = why_not(second, UPDATE["max_U_m"])
            if not worth_another(second, UPDATE["max_U_m"]):
                break
        return why

    def moved(self, name: str, T_now: list[float]) -> MovedTest:
        """The test of a check with the frame ``T_now`` in effect."""
        _, judged, _ = self.measure(name, T_now)
        known = {"T_flange_tool_ref": T_REF, "T_flange_tool_last": T_now}
        tested = judge_moved(judged, known, CHECK)
        return present(tested.result.moved if isinstance(tested, LaserResult) else None, "test of a check")

    def _scan(
        self, name: str, places: int, tool: Array, header: dict[str, Any], reference: dict[str, Any] | None
    ) -> tuple[Path, Record]:
        folder = self.folder / name
        folder.mkdir(parents=True)
        record = take(self.world, folder, self.plan, places, STATED_M, tool)
        then, now = record.passes, []
        if reference is not None:
            then, now = [unpacked(entry) for entry in reference["passes"]], record.passes
        data = {
            "schema": "cellward.laser/1",
            **header,
            "reference": {"passes": then},
            "current": {"passes": now},
        }
        path = folder / DATA_FILE
        path.write_text(json.dumps(data), "utf-8")
        return path, record


def frame_of(found: LaserAnswer) -> list[float]:
    """``T_flange_tool`` of a measurement that was judged."""
    return present(found.T_flange_tool, "frame that was measured")


@patch("procedures.laser.solve.solver.held_out", lambda *_: None)  # nobody looks at it here
def one(folder: Path, cell: str, seed: int, tally: Tally, gates: bool) -> None:
    """One fixture: reference, bump, measurement, and the verdicts."""
    try:
        subject = Fixture(folder, cell, seed)
    except NoAnswerError as refusal:
        tally.failed.append(f"reference: {refusal}")
        return
    off, cov = subject.beams_off()
    tally.beams.append(off)
    tally.beams_cov.append(cov)
    rng = subject.rng
    subject.bend(rng.uniform(-1e-3, 1e-3, 3), rng.uniform(-8e-3, 8e-3, 2))
    began = subject.world.t
    try:
        path, judged, record = subject.measure("update", T_REF)
    except NoAnswerError as refusal:
        tally.failed.append(str(refusal))
        return
    found = judged.result
    tally.take(judged.as_json()["result"], to_pose6(subject.world.T_flange_tool).tolist())
    tally.ways.append(record.ways)
    tally.near.append(record.near)
    tally.seconds.append(subject.world.t - began)
    if not gates:
        return
    if why := subject.refused(path, found):
        tally.refused.append(why)
        return
    test = subject.moved("check", frame_of(found))
    tally.checks += 1
    tally.called_moved += test.moved
    way = rng.standard_normal(3)
    off = present(test.detectable_m, "shift that is found") * way / np.linalg.norm(way)
    p = from_pose6(frame_of(found)).translation
    # Counted from the frame in effect, so that the tool is off it by just that size.
    subject.bend(p - P_REF + off, subject.world.turn[:2])
    tally.bumps += 1
    tally.found += subject.moved("bumped", frame_of(found)).moved


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.laser_scan", description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=COUNT)
    parser.add_argument("cells", nargs="*", default=CELLS, help="such as round-14 or flat-30-late")
    parser.add_argument("--gates", action="store_true", help="and the verdicts of update and check")
    parser.add_argument("--first", type=int, default=0, help="seed of the first; others follow it")
    parser.add_argument("--keep", type=Path, help="file of fixtures: new ones are added, old ones not run")
    options = parser.parse_args(arguments)
    cells, began = list(dict.fromkeys(options.cells)), time.monotonic()
    kind = " with gates" if options.gates else ""
    kept = {cell: Tally.of_file(options.keep, cell + kind) if options.keep else {} for cell in cells}
    tallies = {cell: Tally() for cell in cells}
    # Seed by seed, so that a bench that is ended early has as many of each cell.
    for seed, cell in product(range(options.first, options.first + options.count), cells):
        own = kept[cell].get(seed)
        if own is None:
            own = Tally()
            with tempfile.TemporaryDirectory() as folder:
                one(Path(folder), cell, seed, own, options.gates)
            if options.keep:
                own.keep(options.keep, cell + kind, seed)
        tallies[cell].add(own)
    as_wanted = all([tell(cell, began, tally) for cell, tally in tallies.items()])
    print(f"as wanted: {'yes' if as_wanted else 'NO'}")
    return 0 if as_wanted else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
