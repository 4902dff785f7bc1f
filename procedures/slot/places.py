"""The gripper, and the places where a part is fetched and put down."""

from collections.abc import Callable

import numpy as np

from cell.devices import Speed
from cell.errors import error
from cell.motion import MotionLease
from cell.procedure import Run
from procedures.arm_setup import lease_settings
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.plan import above_place
from procedures.slot.states import PartState, State

_FRESH_S = 0.2  # of the input that confirms what is held


class SlotPlaces:
    """``told(state, why)`` keeps the part's states."""

    def __init__(
        self, config: SlotInsertionConfig, run: Run, speed: Speed, told: Callable[[PartState, str], None]
    ) -> None:
        self.config, self.run, self._speed, self._told = config, run, speed, told
        self.gripper = run.gripper()

    async def fetch(self, lease: MotionLease) -> None:
        """The part in the gripper, or else one at ``fetch_pose``; ``PART_NOT_HELD`` when there is none."""
        name = self.config.fetch_pose
        if await self._holding():
            self._told(PartState.GRIPPED, "")
            return
        if name is None:
            raise error("PART_NOT_HELD", "no fetch_pose is configured, and the gripper holds nothing")

        async def take() -> None:
            await self.run.enter(State.FETCH, name)
            if not await self.gripped_before():
                await self._go(lease, name)
                await self.grip(name)
            await self._leave(lease, name)

        await self.run.take_step(f"fetch a part at {name}", take, measures=False)
        if await self.still_held(State.FETCH):
            return
        raise error("PART_NOT_HELD", f"it was lost on the way from {name}")

    async def put_down(self, lease: MotionLease) -> None:
        """What is held, at ``put_down_pose``."""
        name = str(self.config.put_down_pose)

        async def put() -> None:
            await self.run.enter(State.PUT_DOWN, name)
            await self._go(lease, name)
            await self.let_go()
            await self._leave(lease, name)

        await self.run.take_step(f"put the part down at {name}", put, measures=False)

    async def grip(self, where: str) -> None:
        """``PART_NOT_HELD`` when the fingers close on nothing; they are opened then."""
        timeout = self.config.insertion.grip_timeout_s
        if await self.gripper.grip(timeout):
            self._told(PartState.GRIPPED, "")
            return
        await self.gripper.release(timeout)
        raise error("PART_NOT_HELD", f"the gripper closed on nothing at {where}")

    async def gripped_before(self) -> bool:
        """Whether a step that is taken again has gripped the part already, which is noted."""
        if not await self._holding():
            return False
        self._told(PartState.GRIPPED, "")
        return True

    async def let_go(self) -> None:
        """``PART_NOT_RELEASED`` when the gripper still says that it holds something."""
        if not await self.gripper.release(self.config.insertion.grip_timeout_s):
            raise error("PART_NOT_RELEASED", f"after {self.config.insertion.grip_timeout_s:g} s")
        self._told(PartState.RELEASED, "")

    async def still_held(self, state: State) -> bool:
        """False when the part is gone, which is noted."""
        if await self._holding():
            return True
        self._told(PartState.LOST, f"lost: the gripper holds nothing any more after '{state.value}'")
        return False

    async def _holding(self) -> bool:
        """By an input that is fresh, also where it comes late."""

        async def ask() -> bool:
            return self.gripper.holding(_FRESH_S)

        return await self.run.take_step("look at the gripper", ask, measures=False)

    async def _go(self, lease: MotionLease, name: str) -> None:
        q, model = np.array(self.run.values.poses[name]), lease_settings(self.run.values)[0].model
        above = model.inverse(above_place(self.config, model.forward(q)), q)
        if above is None:
            raise error("MOTION_UNREACHABLE", f"there are no joints above '{name}'")
        await lease.move_joints(above)
        await lease.move_linear(model.forward(q))

    async def _leave(self, lease: MotionLease, name: str) -> None:
        q, model = np.array(self.run.values.poses[name]), lease_settings(self.run.values)[0].model
        await lease.move_linear(above_place(self.config, model.forward(q)))
