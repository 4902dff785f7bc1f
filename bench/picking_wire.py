"""Picking on the wire in real time: genuine ur-rtde servo, slcan encoder, rendered images. What its error is.

``python -m bench.picking_wire [PICKS] [--ideal] [--bind 127.0.53.2]``: in the real world of the scenario, or
in its ideal one. The contact error is the horizontal distance of the tool's true point and the item's true
grasp point at first contact. A run that ends early (a machine whose
cores are taken away for a tenth of a second ends the following) is told, and a new one picks on. Beside it:
what the camera has of the same items, and how far the tool is from its set-points about the contacts; the
rest is forecast and stamps.
"""

import argparse
import json
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench._expected import expect
from cell.poses import Array
from fakes.twin.control import ask
from fakes.world.belt.items import Items
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.belt.record import STEP, STEPS_FILE, read_rows
from tests.kit.wire_cell import WireCell, calibrate_camera, pause, shipped

PERIOD_S = 0.1
LIMIT_M = 1.0e-3
MOST_RUNS = 12


class Watcher:
    """Samples the truth of arm and belt while the job runs: time, joints, travel."""

    def __init__(self, folder: Path) -> None:
        self.rows: list[tuple[float, list[float], float]] = []
        self._folder, self._over = folder, threading.Event()
        self._thread = threading.Thread(target=self._look)
        self._thread.start()

    def end(self) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._over.is_set():
            before = time.monotonic()
            truth = ask(self._folder, {"do": "truth"})
            at = 0.5 * (before + time.monotonic())
            self.rows.append((at, truth["arm"]["q"], truth["belt"]["travel_m"]))
            pause(PERIOD_S)


def following(steps: Any, watcher: Watcher, contacts: list[dict[str, Any]], world: World) -> Array:
    """(k, 3) m: the tool beside its set-points within 0.1 s of contacts."""
    off = []
    for t, q, _ in watcher.rows:
        if any(abs(t - c["t_contact"]) < 0.1 for c in contacts):
            wanted = np.array([np.interp(t, steps["t"], steps["p"][:, axis]) for axis in range(3)])
            tool = (world.true.forward(np.array(q)) * world.T_flange_tool).translation
            off.append(tool - wanted)
    return np.array(off).reshape(-1, 3)


def camera(data: dict[str, Any], watcher: Watcher, world: World) -> Array:
    """(k, 2) m: sightings beside the items that truly lie there, along and across the belt."""
    items = expect(Items, world.items)
    T = items.belt.T_base_belt.inv()
    t, _, travel = (np.array(x, dtype=object) for x in zip(*watcher.rows, strict=True))
    off = []
    for seen in data["detections"]:
        if not t[0] <= seen["t_exp"] <= t[-1]:
            continue
        along, across, _ = T.apply([*seen["xy"], seen["z"]])
        along -= float(np.interp(seen["t_exp"], t.astype(float), travel.astype(float)))
        near = min((items.lying(k) for k in range(200)), key=lambda item: abs(item.along - along))
        off.append([along - near.along, across - near.across])
    return np.array(off).reshape(-1, 2)


def rms(off: Array) -> str:
    return "     -" if not len(off) else f"{1e3 * float(np.sqrt(np.mean(np.sum(off**2, axis=1)))):6.3f}"


@dataclass
class Tally:
    """What the runs showed: the ends, and (k, 2) or (k, 3) m of each kind of error."""

    ends: list[str] = field(default_factory=list)
    taken: int = 0
    contact: list[Array] = field(default_factory=list)
    camera: list[Array] = field(default_factory=list)
    following: list[Array] = field(default_factory=list)


def pick(tally: Tally, folder: Path, bind: str, picks: int, real: bool) -> None:
    """One run in a new cell, for as many picks as are still wanted."""
    scenario = shipped("picking", real, above_m=f"0.05\npicks = {picks}")
    world = World.from_scenario(Scenario.parse(scenario), 0.0)
    cell = WireCell(folder, bind, scenario)
    try:
        cell.start_twin()
        calibrate_camera(cell)
        cell.start_daemon()
        watcher = Watcher(cell.folder)
        cell.start_job("belt-tracking")
        try:
            end = cell.wait_for_end(30.0 + 6.0 * picks)
        finally:
            watcher.end()
        contacts = ask(cell.folder, {"do": "truth"})["gripper"]["contacts"]
        run = cell.runs()[-1].path
        steps = read_rows(run / STEPS_FILE, STEP)
        data = json.loads((run / "intercept.json").read_text("utf-8"))
    finally:
        cell.stop()
    met = [c for c in contacts if c["off_m"] is not None]
    taken = sum(c["taken"] for c in met)
    tally.ends.append(
        f"{taken} taken, {end['outcome']}" + (f": {end['error']['text']}" if end["error"] else "")
    )
    tally.taken += taken
    tally.contact.append(np.array([c["off_m"] for c in met]).reshape(-1, 2))
    tally.camera.append(camera(data, watcher, world))
    tally.following.append(following(steps, watcher, met, world)[:, :2])


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("picks", nargs="?", type=int, default=50)
    parser.add_argument("--ideal", action="store_true", help="in a kinder world than any cell")
    parser.add_argument("--bind", default="127.0.53.2")
    options = parser.parse_args()
    tally = Tally()
    while tally.taken < options.picks and len(tally.ends) < MOST_RUNS:
        with tempfile.TemporaryDirectory() as folder:
            pick(tally, Path(folder), options.bind, options.picks - tally.taken, not options.ideal)
        print(f"run {len(tally.ends)}: {tally.ends[-1]}", flush=True)
    off = np.concatenate(tally.contact)
    print(f"\n{len(off)} contacts, {tally.taken} taken in {len(tally.ends)} run(s)")
    print(f"contact error      {rms(off)} mm RMS, mean {1e3 * off.mean(axis=0) if len(off) else '-'}")
    print(f"camera             {rms(np.concatenate(tally.camera))} mm RMS of one sighting")
    print(f"following          {rms(np.concatenate(tally.following))} mm RMS beside the set-points")
    sizes = np.sort(1e3 * np.linalg.norm(off, axis=1))
    largest = ", ".join(f"{x:.2f}" for x in sizes[-5:])
    print(f"contact errors: median {np.median(sizes):.3f} mm, largest {largest} mm")
    good = tally.taken >= options.picks and bool(np.sqrt(np.mean(np.sum(off**2, axis=1))) <= LIMIT_M)
    print(f"{options.picks} picks within {1e3 * LIMIT_M:g} mm: {'yes' if good else 'NO'}")
    print(f"without an early end: {'yes' if len(tally.ends) == 1 else 'NO'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
