"""A cell with a calibrated camera and a board in it, and the person who brings the tool over its corners."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.targets import make_target
from cell.poses import Array
from daemon.config import CellConfig
from tests.kit.object_cell import WHO, ObjectCell, write_config

TOUCH = "touch-test"
STAND_OFF_M = 0.003
HASTY = {"target": "board", "look_pose": "home", "frames": 2, "settle_s": 0.1, "speed_m_s": 0.1}


def touch_config(folder: Path, **job: Any) -> CellConfig:
    """The scenario ``hand_eye`` in an ideal world, with a touch test."""
    return write_config(folder, jobs={TOUCH: {**HASTY, **job}})


class Toucher:
    """Brings the tool's point where it is asked for, to the twin's truth."""

    def __init__(self, cell: ObjectCell) -> None:
        self.cell, self.world = cell, cell.plant.world
        self.asked: list[str] = []
        self.heights: list[float] = []  # of the tool's point above the board when it was asked for, m

    async def prompt(self) -> int:
        """The number of the next prompt."""
        cell = self.cell
        await cell.until(
            lambda: not cell.engine.active or (cell.engine.run and cell.engine.run.prompt), "a prompt"
        )
        run = cell.engine.run
        assert run is not None
        assert run.prompt is not None, cell.engine.last
        self.asked.append(run.prompt[1])
        self.heights.append(self.height())
        return int(run.prompt[0])

    async def stand(self, off: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Over the corner that is asked for, ``off`` (3,) m of it in the board's frame; and confirm."""
        prompt = await self.prompt()
        found = re.search(r"point (\d+)", self.asked[-1])
        assert found is not None
        point = make_target(self.world.target).points[int(found.group(1))]
        over = np.add(off, (0.0, 0.0, -STAND_OFF_M))
        await self.jog(self.board().apply(point + over))
        await self.cell.engine.confirm(prompt, WHO)
        await self.over(prompt)

    async def skip(self) -> None:
        """The corner that is asked for is left out."""
        prompt = await self.prompt()
        await self.cell.engine.skip(prompt, WHO)
        await self.over(prompt)

    async def over(self, prompt: int) -> None:
        """Until the prompt is over."""
        run = self.cell.engine.run
        await self.cell.until(lambda: run is None or (run.prompt or (0,))[0] != prompt, "the prompt's end")

    async def jog(self, place: Array) -> None:
        """The true tool's point to ``place`` (3,) m in the base."""
        clock, world = self.cell.clock, self.world
        q = world.track.at(clock.now())[0]
        for _ in range(4):
            away = RigidTransform.from_translation(place - world.tool_point(clock.now()))
            q = world.believed.inverse(away * world.believed.forward(q), q)
            world.track.hold(clock.now(), q)
            await clock.sleep(0.2)

    def board(self) -> RigidTransform:
        """Where it truly is, in the base."""
        placement = self.world.operator.placement_at(self.cell.clock.now())
        assert placement is not None
        return self.world.T_mount_target[placement]

    def height(self) -> float:
        """Of the true tool's point above the board, m."""
        return -float(self.board().inv().apply(self.world.tool_point(self.cell.clock.now()))[2])
