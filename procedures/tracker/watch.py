"""Looks at the monuments while an arm is sampled: does the tracker still stand where it stood?"""

import asyncio
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.registration import Registration
from cell.errors import CellError, error
from cell.laser_tracker import StablePoint
from cell.poses import Array
from cell.procedure import Run
from cell.samples import Sample
from procedures.laser_tracker.aiming import AGAIN, Eye
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.monuments import compare, moved_text
from procedures.tracker.record import SampleRecord
from procedures.tracker.states import State as S

MONUMENT_TRUST_M = 0.2  # of a monument's place in the config
MOST_RETRIES = 1  # others can be seen instead


class MonumentWatch:
    """The first look says where the monuments are; every later one is held against it."""

    def __init__(self, run: Run, config: TrackerSamplingConfig, eye: Eye, record: SampleRecord) -> None:
        self._run, self._config, self._eye, self._record = run, config, eye, record

    async def look(self, place: Registration, hidden: NDArray[np.bool_]) -> None:
        """Measure all that can be seen; ``TRACKER_MOVED`` when one is not where the first look saw it.

        ``hidden`` (n,) tells which are behind the arm as it stands. They are left out unless nothing else can
        be held against the first look.
        """
        run, record = self._run, self._record
        await run.enter(S.MONUMENTS, f"after {len(record.samples)} poses")
        first = record.looks[0]["points"] if record.looks else {}
        points: dict[str, Any] = {}
        failure: CellError | None = None
        names = list(self._config.monuments)
        vouching = np.array([name in first or not first for name in names])
        none_left = not np.any(vouching & ~hidden)
        for (name, monument), behind, vouches in zip(
            self._config.monuments.items(), hidden, vouching, strict=True
        ):
            if behind and not (none_left and vouches):
                run.note("decision", event="monument not seen", monument=name, why="the arm is in the way")
                continue
            near = place.to_tracker(np.array(monument.point)[:, None])[:, 0]
            if name in first:
                near = np.array(first[name]["p_tracker"])
            found = await run.take_step(f"monument {name}", partial(self._measure, name, near))
            if isinstance(found, CellError):
                failure = found
                run.note("decision", event="monument not seen", monument=name, why=str(found))
                continue
            points[name] = {
                "p_tracker": [float(v) for v in found.value.point],
                "sigma_m": self._eye.sigma_m(found.value.point),
                "scatter_m": found.value.scatter_m,
            }
        moved = compare(first, points)
        if not points or (first and not moved):
            # Each was either seen or failed; an adopted run may know only monuments of another config.
            raise failure or error(
                "TRACKER_MOVED",
                f"whether it moved is unknown: of {', '.join(first)}, which the first look saw, none is seen",
            )
        look = {"after": len(record.samples), "t": run.clock.now(), "points": points}
        await asyncio.to_thread(record.add_look, look)
        if (text := moved_text(moved, self._config.max_drift_m)) is not None:
            raise error(
                "TRACKER_MOVED", f"{text}; poses since the look before cannot be used with the others"
            )

    async def _measure(self, name: str, near: Array) -> Sample[StablePoint] | CellError:
        """The point, or why it could not be had in the end."""
        if self._config.swap_by_operator:
            await self._run.ask(f"Put the reflector on monument {name}, then confirm.")
        retries = min(self._config.retries_per_pose, MOST_RETRIES)
        for attempt in range(1, retries + 2):
            try:
                return await self._eye.measure(name, near, MONUMENT_TRUST_M)
            except CellError as failure:
                if failure.name not in AGAIN:
                    raise
                last = failure
            if attempt <= retries:
                await self._run.enter(S.REACQUIRE, last.detail)
                await self._eye.find_again(near)
                await self._run.enter(S.MONUMENTS, name)
        return last
