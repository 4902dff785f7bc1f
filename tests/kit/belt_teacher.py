"""The operator of a belt's calibration by touch."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from tests.kit.object_cell import ObjectCell


class Teacher:
    """The operator who meets one mark on the belt with the tool's point, whenever the job asks."""

    def __init__(self, cell: ObjectCell) -> None:
        self.cell, self.world = cell, cell.plant.world
        assert self.world.belt is not None
        self.belt = self.world.belt
        self.mark = self.belt.T_base_belt.translation + np.array([0.6, 0.0, 0.02])
        self.begin = self.belt.travel_at(cell.clock.now())
        self.asked: list[str] = []

    async def touch(self, creep_m_s: float = 0.0) -> None:
        """Let the belt run and stop (or creep on), jog to the mark, and confirm."""
        cell, clock = self.cell, self.cell.clock
        await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
        run = cell.engine.run
        assert run is not None
        assert run.prompt is not None
        self.asked.append(run.prompt[1])
        self.belt.run(clock.now(), 0.15)
        await clock.sleep(2.0)
        self.belt.run(clock.now(), creep_m_s)
        await clock.sleep(1.0)
        now = clock.now()
        here = self.mark + (self.belt.travel_at(now) - self.begin) * self.belt.direction
        q, tool = self.world.track.at(now)[0], self.world.T_flange_tool
        attitude = (self.world.believed.forward(q) * tool).rotation
        goal = RigidTransform.from_components(here, attitude) * tool.inv()
        self.world.track.hold(now, self.world.believed.inverse(goal, q))
        await clock.sleep(1.0)
        await cell.engine.confirm(run.prompt[0], "test")
        await cell.until(lambda: run.prompt is None, "the prompt's end")
        await clock.sleep(0.2)
