"""The pieces of a trajectory on their way to the motion child, which follows them."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Self

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from cell.devices import TrajectoryPiece
from cell.errors import CellError, error
from cell.poses import Array
from drivers.ur.framing import Message
from drivers.ur.motion_client import MotionClient
from drivers.ur.watch import ArmView, Watch, drop

Joints = Callable[[], Array]

MAX_START_STEP_RAD = 0.05
AFTER_GAP_S = 0.3  # so long after a time without states the arm may still be far from its set-points
ASK_S = 0.2  # before a piece ends; who makes short ones then sets the pace


class Following:
    """Sends pieces for as long as the child follows them; ``watch`` learns how following ended.

    Use as a context manager around the motion.
    """

    def __init__(self, client: MotionClient, arm: ArmView, watch: Watch, time_offset_s: float) -> None:
        self._time_offset_s = time_offset_s  # that states are shifted by, and set-points are not
        self._client, self._arm, self._watch, self._clock = client, arm, watch, client.clock
        self._broken_off: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def __enter__(self) -> Self:
        self._undo = self._client.subscribe(self._hear)
        self._client.idle.clear()
        return self

    def __exit__(self, *exc: object) -> None:
        self._undo()

    async def send(self, pieces: AsyncIterator[TrajectoryPiece], joints: Joints) -> TrajectoryPiece | None:
        """Send each when the one before ends within 200 ms, and tell the child which was the last.

        The first has to begin at the arm's ``joints`` (6,) rad: ``MOTION_LIMIT``.
        """
        last: TrajectoryPiece | None = None
        iterator = aiter(pieces)
        while not self._over:
            pull = asyncio.ensure_future(anext(iterator, None))
            try:
                if not await self._watch.first(pull, self._broken_off):
                    break
                piece = pull.result()
            finally:
                await drop(pull)
            if piece is None:
                break
            self._post(piece, joints() if last is None else None)
            last = piece
            while not self._over and (left := last.t1 - ASK_S - self._clock.now()) > 0.0:
                await self._clock.sleep(min(left, 0.02))
        self._client.post("finish")
        return last

    def explained(self, failure: CellError) -> CellError:
        """``failure``; where an arm seems not to follow as nothing was sent or seen for a moment, that."""
        now, gap = self._clock.now(), self._arm.state.last_gap
        if failure.name != "ARM_NOT_FOLLOWING":
            return failure
        if self._client.kicks.lapsed_at(now, 0.0):
            return error("MOTION_WATCHDOG", f"the motion client was late; {failure.detail}")
        if gap is not None and now - gap[1] < AFTER_GAP_S:
            gone = f"the arm gave no state for {gap[1] - gap[0]:.3f} s"
            return error("STALE_DATA", f"{gone}; {failure.detail}")
        return failure

    @property
    def _over(self) -> bool:
        return self._watch.over or self._broken_off.done()

    def _post(self, piece: TrajectoryPiece, begins_at: Array | None) -> None:
        rows = np.asarray(piece.coefficients, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != 6 or not np.isfinite(rows).all() or not piece.t1 > piece.t0:
            raise error(
                "ARGUMENT_INVALID", f"a trajectory piece of shape {rows.shape} over {piece.t1 - piece.t0} s"
            )
        if begins_at is not None:
            step = float(np.max(np.abs(rows[0] - begins_at)))
            if step > MAX_START_STEP_RAD:
                raise error("MOTION_LIMIT", f"the trajectory begins {step:.3f} rad from where the arm is")
        state = self._arm.state.last()
        cycle = None if state is None else state.t + self._time_offset_s
        self._client.post("piece", t0=piece.t0, t1=piece.t1, coefficients=rows.tolist(), cycle=cycle)

    def _hear(self, event: Message) -> None:
        if event["event"] == "followed":
            self._watch.end(event["end"])
        elif event["event"] == "broken off" and not self._broken_off.done():
            self._broken_off.set_result(None)


def rest_after(last: TrajectoryPiece, decel: float) -> Array:
    """Where the joints (6,) rad come to rest: an end speed other than zero ends in a ramp with ``decel``
    (rad/s^2), which goes on beyond the last set-point."""
    rows = np.asarray(last.coefficients, dtype=float)
    span = last.t1 - last.t0
    target, speed = polyval(span, rows), polyval(span, polyder(rows))
    out: Array = target + speed * float(np.max(np.abs(speed))) / (2.0 * decel)
    return out
