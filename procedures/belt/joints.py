"""From the tool's motion to the arm's: set-points as joint polynomials."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.belt.pursuit import Leg, State
from cell.arm_model import ArmModel
from cell.devices import TrajectoryPiece
from cell.errors import error
from cell.poses import Array

_FARTHEST_RAD = 0.5  # from one look to the next; more would be another branch
_LOOKS = 13  # along a leg or a piece


class ToolJoints:
    """A tool that stays upright: ``yaw`` 0 is its attitude at the pose ``q_upright`` (6,).

    ``T_flange_tool`` has the tool's point as its origin.
    """

    def __init__(self, model: ArmModel, T_flange_tool: RigidTransform, q_upright: Array) -> None:
        self._model, self._T_flange_tool = model, T_flange_tool
        self._T_tool_flange = T_flange_tool.inv()
        self._upright: Rotation = (model.forward(q_upright) * T_flange_tool).rotation

    def heading(self) -> float:
        """Of the tool's x axis about base z at yaw 0, rad."""
        x = self._upright.as_matrix()[:, 0]
        return float(np.arctan2(x[1], x[0]))

    def lean(self, q: Array) -> float:
        """How far the tool's axis at ``q`` (6,) is from straight down, rad."""
        axis = (self._model.forward(q) * self._T_flange_tool).rotation.apply([0.0, 0.0, 1.0])
        return float(np.arccos(np.clip(-axis[2], -1.0, 1.0)))

    def state(self, q: Array) -> State:
        """The tool at rest at ``q`` (6,)."""
        tool = self._model.forward(q) * self._T_flange_tool
        turn = (tool.rotation * self._upright.inv()).as_rotvec()
        return State.still(np.array([*tool.translation, float(turn[2])]))

    def flange(self, state: State) -> RigidTransform:
        """``T_base_flange`` for the tool at ``state``."""
        rotation = Rotation.from_rotvec([0.0, 0.0, state.p[3]]) * self._upright
        return RigidTransform.from_components(state.p[:3], rotation) * self._T_tool_flange

    def joints(self, state: State, near: Array) -> tuple[Array, Array]:
        """Joints (6,) and joint speeds (6,) for the tool at ``state``, on the branch of ``near`` (6,)."""
        T = self.flange(state)
        q = self._model.inverse(T, near)
        if q is None or float(np.max(np.abs(q - near))) > _FARTHEST_RAD:
            x, y, z = state.p[:3]
            raise error("MOTION_UNREACHABLE", f"the tool at {x:.3f}, {y:.3f}, {z:.3f} m")
        spin = np.array([0.0, 0.0, state.v[3]])
        twist = np.concatenate([state.v[:3] + np.cross(spin, T.translation - state.p[:3]), spin])
        return q, np.linalg.solve(self._model.jacobian(q), twist)

    def fastest(self, leg: Leg, near: Array) -> float:
        """The highest joint speed on the way of ``leg``, rad/s, from joints ``near`` (6,) on."""
        speeds, q = [], near
        for t in np.linspace(leg.t0, leg.t1, _LOOKS):
            q, qd = self.joints(leg.at(float(t)), q)
            speeds.append(float(np.max(np.abs(qd))))
        return max(speeds)

    def piece(self, t0: float, h: float, states: Sequence[tuple[Array, Array]]) -> TrajectoryPiece:
        """The polynomial through joints and joint speeds (6,) at ``t0``, ``t0 + h``, ... (Hermite)."""
        wanted = np.array([row for q, v in states for row in (q, h * v)])
        powers = h ** -np.arange(float(len(wanted)))
        coefficients = powers[:, None] * (_hermite(len(states)) @ wanted)
        return TrajectoryPiece(t0, t0 + h * (len(states) - 1), coefficients)


def fastest_joint(piece: TrajectoryPiece) -> float:
    """The highest joint speed in ``piece``, rad/s."""
    s = np.linspace(0.0, piece.t1 - piece.t0, _LOOKS)[:, None]
    k = np.arange(1.0, len(piece.coefficients))
    return float(np.max(np.abs((k * s ** (k - 1.0)) @ piece.coefficients[1:])))


@lru_cache
def _hermite(nodes: int) -> Array:
    """(2 n, 2 n): from values and slopes at 0, 1, ... n - 1 to coefficients, lowest power first."""
    u, k = np.arange(float(nodes))[:, None], np.arange(2.0 * nodes)
    slopes = k * u ** np.maximum(k - 1.0, 0.0)
    return np.asarray(np.linalg.inv(np.stack([u**k, slopes], axis=1).reshape(2 * nodes, -1)))
