"""What one decision of picking costs while more and more items are on their way, in a cell on virtual time.

``python -m bench.belt_queue [SECONDS] [--belt KIND]``: a camera 13 m upstream sees seven items a second come,
4 cm behind each other; the arm picks what it can of those in its zone and lets the others pass. A decision is
due every 20 ms: taking in counts and sightings, choosing an item, planning the way and the joints. Counted is
the processor's time that the decision itself takes, not that of others on the loop.
"""

import argparse
import gc
import logging
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Generator
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from bench._expected import expect
from fakes.object import run_virtual
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.motion.picker import Picker
from procedures.belt.motion.tool_path import STEP_S
from tests.kit.picking_cell import picking_cell, picking_config

FAR_M = 13.0
WORLD = {
    "T_base_camera": f"[{-FAR_M}, 0.553, 0.952, 3.1275, 0.0218, 0.0163]",
    "origin": f"[{-FAR_M}, {0.55 + 0.02 * (FAR_M - 0.7)}, 0.15]",
    "spacing_m": "0.04",
    "jitter_m": "0.0",
    "lateral_m": "0.04",
    "first_m": "-0.1\ngone_m = 20.0",
}
SPEED = "[{ speed_m_s = 0.3 }]"
BELTS = {
    "constant": SPEED,
    "ripple": SPEED + "\nripple = [{ amplitude = 0.02, hz = 0.7 }, { amplitude = 0.006, hz = 2.9 }]",
    "stop-start": SPEED + "\nstops = { every_s = [1.0, 3.0], accel_m_s2 = [0.3, 1.2], held_s = [0.2, 1.0] }",
}
BIN = 50
T = TypeVar("T")


class Stepped(Generic[T]):
    """Awaits ``what`` and adds up the time (s) of its own steps, not of what runs while it waits."""

    def __init__(self, what: Awaitable[T]) -> None:
        self._what, self.cost = what, 0.0

    def __await__(self) -> Generator[Any, Any, T]:
        steps = self._what.__await__()
        while True:
            begun = time.thread_time()
            try:
                waits_for = next(steps)
            except StopIteration as end:
                value: T = end.value
                return value
            finally:
                self.cost += time.thread_time() - begun
            try:
                yield waits_for
            except BaseException as exc:
                steps.throw(exc)


def picker_with_costs(costs: dict[int, list[tuple[float, float]]]) -> None:
    """From now on every decision adds what it took (s), learning and all, by the length of the queue."""
    pieces, learn = Picker.pieces, BeltWatch.learn
    learning = 0.0

    def timed_learn(self: BeltWatch) -> Any:
        nonlocal learning
        begun = time.thread_time()
        out = learn(self)
        learning = time.thread_time() - begun
        return out

    async def timed(self: Picker, q: Any) -> AsyncIterator[Any]:
        nonlocal learning
        made = expect(AsyncGenerator, pieces(self, q))
        try:
            while True:
                learning, step = 0.0, Stepped(anext(made))
                try:
                    piece = await step
                except StopAsyncIteration:
                    return
                costs[self._watch.queue.length // BIN].append((learning, step.cost))
                yield piece
        finally:
            await made.aclose()

    Picker.pieces, BeltWatch.learn = timed, timed_learn  # type: ignore[method-assign]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("seconds", nargs="?", type=float, default=55.0)
    parser.add_argument("--belt", choices=BELTS, default="constant")
    options = parser.parse_args()
    logging.disable(logging.ERROR)
    costs: dict[int, list[tuple[float, float]]] = defaultdict(list)
    picker_with_costs(costs)
    world = {**WORLD, "profile": BELTS[options.belt]}

    async def scene(folder: Path) -> None:
        async with picking_cell(picking_config(folder, {"queue_limit": 2000}, world)) as cell:
            gc.collect()
            gc.freeze()  # as the daemon does
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
    print("on their way  decisions   learn ms, most   all ms  95 % ms  longest")
    for k, rows in sorted(costs.items()):
        learnt, whole = 1e3 * np.array(rows).T
        figures = f"{np.median(learnt[learnt > 0.0]):11.2f}{learnt.max():7.2f}"
        figures += f"{np.median(whole):9.2f}{np.quantile(whole, 0.95):9.2f}{whole.max():9.2f}"
        print(f"{BIN * k:4d} to {BIN * (k + 1) - 1:<4d}{len(rows):11d}{figures}")
    print(f"a decision is due every {1e3 * STEP_S:g} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
