"""An arm seen and moved through another model of it than its controller has.

The controller tells joints, and a pose that follows from them by what it believes; a pose that it is told it
turns into joints by the same belief. A calibrated model knows better where the flange is. Whoever works with
the arm through this class sees flange poses as that model has them, and asks for such: a pose that goes to
the controller is the one that *it* takes for the joints which truly lead there. Joints go as they are.
"""

from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.arm_model import ArmModel
from cell.devices import Arm, ArmState, Identity, MotionPort, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError, error
from cell.motion import FRESH_WITHIN_S, MAX_STATE_AGE_S
from cell.poses import Array, exp_xi, log_xi
from cell.samples import Mapped, Readings

BELIEF_M, BELIEF_RAD = 0.0003, 0.0003  # pendant and model of a real UR agree to 0.09 mm at worst
_STEP_M, _STEP_RAD = 0.05, 0.2  # along a line, so that its end is found on the branch that it begins on


@dataclass(frozen=True)
class ArmModels:
    """``own`` says where the flange truly is, ``believed`` where the controller takes it to be."""

    own: ArmModel
    believed: ArmModel

    def told(self, T_base_flange: RigidTransform, q: Array) -> RigidTransform:
        """What the controller has to be told for the true flange to go from joints ``q`` (6,) to a pose.

        ``MOTION_UNREACHABLE`` when no joints lead there. Between the ends of a line the flange is off it by
        what the difference of the models curves on the way: some 10 um over 0.1 m for a difference of 2 mm.
        """
        start = self.own.forward(q)
        way = log_xi(start.inv() * T_base_flange)
        length, turn = (float(np.linalg.norm(part)) for part in (way[:3], way[3:]))
        steps = max(1, ceil(length / _STEP_M), ceil(turn / _STEP_RAD))
        for k in range(1, steps + 1):
            pose = T_base_flange if k == steps else start * exp_xi(k / steps * way)
            found = self.own.inverse(pose, q)
            if found is None:
                x, y, z = T_base_flange.translation
                raise error(
                    "MOTION_UNREACHABLE", f"the flange pose at {x:.3f}, {y:.3f}, {z:.3f} m has no joints"
                )
            q = found
        return self.believed.forward(q)

    def check_belief(self, state: ArmState) -> None:
        """``KINEMATICS_OTHER_ARM`` when the controller's ``state`` shows that it believes something else."""
        off = log_xi(self.believed.forward(state.q).inv() * replace(state, model=None).T_base_flange)
        shift, turn = (float(np.linalg.norm(part)) for part in (off[:3], off[3:]))
        if shift > BELIEF_M or turn > BELIEF_RAD:
            raise error(
                "KINEMATICS_OTHER_ARM",
                f"the controller reports the flange {1e3 * shift:.2f} mm and {1e3 * turn:.2f} mrad from "
                f"where [robot] model '{self.believed.name}' with its factory calibration has it, so its "
                "model is unknown",
            )


class ModelledArm:
    """``arm`` with flange poses by ``models.own``. Implements :class:`cell.devices.Arm`."""

    def __init__(self, arm: Arm, models: ArmModels) -> None:
        self.name, self._arm, self._models = arm.name, arm, models
        self._state = Mapped(arm.state, self._see)

    @property
    def state(self) -> Readings[ArmState]:
        return self._state

    def _see(self, state: ArmState) -> ArmState:
        return replace(state, model=self._models.own)

    async def open_motion(self, tool: ToolSettings) -> MotionPort:
        """As the arm's own, and refused when the controller believes something else than is known."""
        self._models.check_belief(await _state(self._arm))
        return ModelledPort(await self._arm.open_motion(tool), self._arm, self._models)

    @property
    def expected_lag_s(self) -> float:
        return self._arm.expected_lag_s

    @property
    def motion_begun(self) -> bool:
        return self._arm.motion_begun

    async def open(self) -> None:
        await self._arm.open()

    async def close(self) -> None:
        await self._arm.close()

    async def identify(self) -> Identity:
        return await self._arm.identify()

    async def wait_fresh(self, timeout: float) -> None:
        await self._arm.wait_fresh(timeout)

    async def wait_lost(self) -> Exception:
        return await self._arm.wait_lost()

    def health(self) -> dict[str, Any]:
        return self._arm.health()

    def check_movable(self) -> None:
        self._arm.check_movable()

    def fault(self) -> Exception | None:
        return self._arm.fault()

    async def stop_script(self) -> None:
        await self._arm.stop_script()

    async def stop_program(self) -> None:
        await self._arm.stop_program()


class ModelledPort:
    """``port`` with poses as the controller takes them: a :class:`cell.devices.MotionPort`."""

    def __init__(self, port: MotionPort, arm: Arm, models: ArmModels) -> None:
        self._port, self._arm, self._models = port, arm, models

    @property
    def usable(self) -> bool:
        return self._port.usable

    @property
    def ended_unseen(self) -> bool:
        return self._port.ended_unseen

    async def move_linear(self, T_base_flange: RigidTransform, speed: Speed) -> None:
        await self._port.move_linear(await self._told(T_base_flange), speed)

    async def guarded_move(
        self, T_base_flange: RigidTransform, speed: Speed, max_force_n: float, max_travel_m: float
    ) -> bool:
        told = await self._told(T_base_flange)
        return await self._port.guarded_move(told, speed, max_force_n, max_travel_m)

    async def _told(self, T_base_flange: RigidTransform) -> RigidTransform:
        return self._models.told(T_base_flange, (await _state(self._arm)).q)

    async def move_joints(self, q: Array, speed: Speed) -> None:
        await self._port.move_joints(q, speed)

    async def stream(self, pieces: AsyncIterator[TrajectoryPiece]) -> None:
        await self._port.stream(pieces)

    async def set_tool(self, tool: ToolSettings) -> None:
        await self._port.set_tool(tool)

    async def decelerate(self) -> None:
        await self._port.decelerate()

    async def close(self) -> None:
        await self._port.close()


async def _state(arm: Arm) -> ArmState:
    """What the controller reports now; a short silence, as while a long line was checked, is waited out."""
    try:
        return arm.state.latest(MAX_STATE_AGE_S).value
    except CellError:
        await arm.wait_fresh(FRESH_WITHIN_S)
        return arm.state.latest(MAX_STATE_AGE_S).value
