"""What one decision of picking costs while more and more items are on their way, in a cell on virtual time.

``python -m bench.belt_queue [SECONDS]``: a camera 13 m upstream sees seven items a second come, 4 cm
behind each other; the arm picks what it can of those in its zone and lets the others pass. A decision is due
every 20 ms: taking in counts and sightings, choosing an item, planning the way and the joints.
"""

import argparse
import logging
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from fakes.object import run_virtual
from procedures.belt.picker import STEP_S, Picker
from tests.unit.picking_cell import picking_cell, picking_config

FAR_M = 13.0
WORLD = {
    "T_base_camera": f"[{-FAR_M}, 0.553, 0.952, 3.1275, 0.0218, 0.0163]",
    "origin": f"[{-FAR_M}, {0.55 + 0.02 * (FAR_M - 0.7)}, 0.15]",
    "profile": "[{ speed_m_s = 0.3 }]",
    "spacing_m": "0.04",
    "jitter_m": "0.0",
    "lateral_m": "0.04",
    "gone_m": "20.0",
}
BIN = 50


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("seconds", nargs="?", type=float, default=55.0)
    options = parser.parse_args()
    logging.disable(logging.ERROR)
    costs: dict[int, list[tuple[float, float]]] = defaultdict(list)
    learn, piece = Picker._learn, Picker._piece

    async def timed_learn(self: Picker) -> None:
        self.begun = time.thread_time()  # type: ignore[attr-defined]
        await learn(self)
        self.learnt = time.thread_time()  # type: ignore[attr-defined]

    def timed_piece(self: Picker, *args: Any) -> Any:
        out = piece(self, *args)
        begun, learnt = self.begun, self.learnt  # type: ignore[attr-defined]
        costs[self._watch.queue.length // BIN].append((learnt - begun, time.thread_time() - begun))
        return out

    Picker._learn, Picker._piece = timed_learn, timed_piece  # type: ignore[method-assign]

    async def scene(folder: Path) -> None:
        async with picking_cell(picking_config(folder, {"queue_limit": 2000}, WORLD)) as cell:
            run_id = await cell.start()
            give_up = cell.clock.now() + options.seconds
            while cell.engine.active and cell.clock.now() < give_up:
                await cell.clock.sleep(0.5)
            if cell.engine.active:
                await cell.engine.finish("bench")
            end = await cell.finished(run_id)
            print(f"run {end['outcome']} {end['error'] or ''}")

    with tempfile.TemporaryDirectory() as folder:
        run_virtual(scene(Path(folder)))
    print("on their way  decisions  learn ms   all ms  95 % ms  longest")
    for k, rows in sorted(costs.items()):
        learnt, whole = 1e3 * np.array(rows).T
        figures = f"{np.median(learnt):10.2f}{np.median(whole):9.2f}{np.quantile(whole, 0.95):9.2f}"
        print(f"{BIN * k:4d} to {BIN * (k + 1) - 1:<4d}{len(rows):11d}{figures}{whole.max():9.2f}")
    print(f"a decision is due every {1e3 * STEP_S:g} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
