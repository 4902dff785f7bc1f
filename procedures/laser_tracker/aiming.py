"""The tracker as a sampling uses it: aim where the reflector should be, measure, believe it only there."""

import numpy as np

from cell.errors import CellError, error
from cell.laser_tracker import StablePoint
from cell.poses import Array
from cell.procedure import Run
from cell.samples import Sample
from procedures.laser_tracker.looking import Looking

LOST = (
    "TRACKER_NO_TARGET",
    "TRACKER_BEAM_BROKEN",
    "TRACKER_WRONG_TARGET",
)  # search again before the next try
AGAIN = (*LOST, "TRACKER_UNSTABLE", "POSE_UNSTABLE")  # the pose can be tried again
_FOLLOWED_M = 0.03  # it still looks at the reflector that it followed
_FRESH_S = 0.5


class Eye:
    """Measures one reflector after the other; keeps in mind which one the tracker is set to."""

    def __init__(self, run: Run, config: Looking) -> None:
        self._run, self._config, self.tracker = run, config, run.tracker()
        self._selected: tuple[str, int] | None = None  # and in which epoch: an instrument forgets

    async def measure(self, name: str, near: Array | None, surprise_m: float) -> Sample[StablePoint]:
        """One try at reflector ``name`` that should be at ``near`` (3,), tracker frame, give or take
        ``surprise_m``; None: it is followed, wherever it is.

        One of ``AGAIN`` when it cannot be measured now.
        """
        config = self._config
        if self._selected != (name, epoch := self.tracker.readings.epoch):
            await self.tracker.select(name)
            self._selected = name, epoch
        if not self._follows(near):
            await self.find(near)
        found = await self.tracker.measure(config.window_s, config.max_scatter_m, config.measure_timeout_s)
        if near is not None:
            off = float(np.linalg.norm(found.value.point - near))
            if off > surprise_m:
                raise error(
                    "TRACKER_WRONG_TARGET",
                    f"{name} is seen {1e3 * off:.0f} mm from where it should be, the limit is "
                    f"{1e3 * surprise_m:.0f} mm",
                )
        return found

    async def find(self, near: Array | None) -> None:
        """Search where the reflector should be."""
        await self.tracker.find(near, self._config.find_timeout_s)

    async def find_again(self, near: Array | None) -> None:
        """After a loss: give the beam time to be free, then search; the next try says whether it worked."""
        await self._run.clock.sleep(self._config.reacquire_wait_s)
        try:
            await self.find(near)
        except CellError as failure:
            if failure.name not in AGAIN:
                raise

    def sigma_m(self, point: Array) -> float:
        """Standard deviation of a reading at ``point`` along one axis, as stated for the instrument."""
        noise = self.tracker.noise
        return float(noise.sigma0_m + noise.sigma_per_m * np.linalg.norm(point))

    def _follows(self, near: Array | None) -> bool:
        newest = self.tracker.readings.last()
        if newest is None or self._run.clock.now() - newest.t > _FRESH_S:
            return False
        state = newest.value
        if not state.locked or state.point is None:
            return False
        return near is None or float(np.linalg.norm(state.point - near)) < _FOLLOWED_M
