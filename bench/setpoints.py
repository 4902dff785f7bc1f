"""How evenly the arm follows a steady stream, by where in the controller's cycle its set-points are sent.

One simulated controller, a pure delay as in the scenario picking, one joint at a steady speed. ``own step``
is the peer: set-points at the controller's rate in whatever step the stream began. A cycle is off where the
joint moves more than a tenth beside its speed from one state to the next. ``python -m bench.setpoints
[STREAMS]``; each takes two seconds. Whole cells beside it make every row worse: it is for an idle machine.
"""

import asyncio
import sys
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import numpy as np

from cell.clock import MonotonicClock
from cell.devices import ToolSettings, TrajectoryPiece
from cell.errors import CellError
from cell.poses import Array, from_pose6
from drivers.ur import UrArm
from drivers.ur.motion import UrMotion
from drivers.ur.pace import SENT_AT
from fakes.ur.process import running_controller

HOST, SCENARIO, STREAMS = "127.0.0.38", "picking", 12
SPEED_RAD_S, LASTS_S, CYCLE_S = 0.3, 1.5, 0.002
OFF = 0.1  # of the speed
PLACES = (
    None,
    0.0,
    0.1,
    0.25,
    SENT_AT,
    0.5,
    0.6,
    0.75,
    0.9,
)  # of a cycle; None: its own step, before any is told
TOOL = ToolSettings(from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]), 1.2)


def sent_at(post: Callable[..., None], place: float | None) -> Callable[..., None]:
    """``post`` of a motion client that keeps set-points to ``place`` of a cycle."""

    def posted(do: str, **arguments: Any) -> None:
        cycle = arguments.pop("cycle", None)
        if cycle is not None and place is not None:
            arguments["cycle"] = cycle + (place - SENT_AT) * CYCLE_S
        post(do, **arguments)

    return posted


async def off_speed(arm: UrArm, port: UrMotion, sign: int) -> Array:
    """(n,) of a stream: how far each cycle was beside the speed, as a share of it."""
    q0, begin = (
        arm.state.latest(1.0).value.q,
        time.monotonic() + 0.1 + np.random.default_rng().random() * CYCLE_S,
    )
    direction = sign * SPEED_RAD_S * np.eye(6)[0]

    async def pieces() -> AsyncIterator[TrajectoryPiece]:
        t = begin
        while t < begin + LASTS_S:
            yield TrajectoryPiece(t, t + 0.15, np.array([q0 + (t - begin) * direction, direction]))
            await asyncio.sleep(max(t + 0.008 - time.monotonic(), 0.0))
            t += 0.02

    await port.stream(pieces())
    states = arm.state.between(begin + 0.3, begin + LASTS_S - 0.1)
    q = np.array([state.value.q[0] for state in states])
    t = np.array([state.value.stamp for state in states])
    return np.asarray(np.diff(q) / np.diff(t) / (sign * SPEED_RAD_S) - 1.0)


async def measure(streams: int) -> None:
    config = UrArm.Config(host=HOST, stale_after_s=1.0, silent_after_s=1.0, lost_after_s=2.0)
    arm = UrArm("arm", config, MonotonicClock())
    await arm.open()
    port = await arm.open_motion(TOOL)
    post = port.client.post
    print("sent at, of a cycle   cycles off by > 10 %   the worst stream   speed RMS beside it")
    try:
        for place in PLACES:
            port.client.post = sent_at(post, place)  # type: ignore[method-assign]
            off = [await off_speed(arm, port, 1 - 2 * (k % 2)) for k in range(streams)]
            share = [float(np.mean(np.abs(one) > OFF)) for one in off]
            rms = float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
            name = "own step" if place is None else f"{place:.2f}{' in use' if place == SENT_AT else ''}"
            print(f"{name:<21} {np.mean(share):>19.2%} {max(share):>18.2%} {rms:>19.1%}", flush=True)
    finally:
        await port.close()
        await arm.close()


def main(arguments: list[str]) -> None:
    streams = int(arguments[0]) if arguments else STREAMS
    with running_controller(HOST, SCENARIO):
        try:
            asyncio.run(measure(streams))
        except CellError as why:
            sys.exit(f"a stream was interrupted, run it again on an idle machine: {why}")


if __name__ == "__main__":
    main(sys.argv[1:])
