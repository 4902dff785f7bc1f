"""From the tool's motion to the arm's: set-points as joint polynomials."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.belt.pursuit import Leg, PursuitState
from cell.arm_model import ArmModel
from cell.devices import TrajectoryPiece
from cell.errors import error
from cell.poses import Array

_FARTHEST_RAD = 0.5  # from one look to the next; more would be another branch
_WALK_M = 0.04  # between the joints on a way whose end is wanted
_LOOKS = 13  # along a leg or a piece


class ToolJoints:
    """A tool that stays upright: ``yaw`` 0 is its attitude at the pose ``q_upright`` (6,).

    ``T_flange_tool`` has the tool's point as its origin.
    """

    def __init__(self, model: ArmModel, T_flange_tool: RigidTransform, q_upright: Array) -> None:
        self._model, self._T_flange_tool = model, T_flange_tool
        self._upright: Rotation = (model.forward(q_upright) * T_flange_tool).rotation
        upright = RigidTransform.from_rotation(self._upright) * T_flange_tool.inv()
        self._upright_flange: Array = upright.as_matrix()  # about the tool's point

    def heading(self) -> float:
        """Of the tool's x axis about base z at yaw 0, rad."""
        x = self._upright.as_matrix()[:, 0]
        return float(np.arctan2(x[1], x[0]))

    def lean(self, q: Array) -> float:
        """How far the tool's axis at ``q`` (6,) is from straight down, rad."""
        axis = (self._model.forward(q) * self._T_flange_tool).rotation.apply([0.0, 0.0, 1.0])
        return float(np.arccos(np.clip(-axis[2], -1.0, 1.0)))

    def state(self, q: Array) -> PursuitState:
        """The tool at rest at ``q`` (6,)."""
        tool = self._model.forward(q) * self._T_flange_tool
        turn = (tool.rotation * self._upright.inv()).as_rotvec()
        return PursuitState.still(np.array([*tool.translation, float(turn[2])]))

    def moving(self, q: Array, qd: Array) -> PursuitState:
        """The tool at ``q`` (6,) rad with joint speeds ``qd`` (6,) rad/s, without acceleration."""
        flange = self._model.forward(q)
        twist = self._model.jacobian_many(q[None])[0] @ qd
        lever = flange.rotation.apply(self._T_flange_tool.translation)
        velocity = twist[:3] + np.cross(twist[3:], lever)
        return PursuitState(self.state(q).p, np.array([*velocity, float(twist[5])]), np.zeros(4))

    def speeds(self, Q: Array, Qd: Array) -> Array:
        """How fast the tool's point is (n,) m/s at joints ``Q`` with joint speeds ``Qd`` (n, 6)."""
        lever = self._model.flange_many(Q)[:, :3, :3] @ self._T_flange_tool.translation
        twists = np.einsum("nij,nj->ni", self._model.jacobian_many(Q), Qd)
        return np.asarray(np.linalg.norm(twists[:, :3] + np.cross(twists[:, 3:], lever), axis=1))

    def points(self, Q: Array) -> Array:
        """The tool's point (n, 3) in the base at joints ``Q`` (n, 6)."""
        flanges = self._model.flange_many(Q)
        out: Array = flanges[:, :3, :3] @ self._T_flange_tool.translation + flanges[:, :3, 3]
        return out

    def flanges(self, states: Sequence[PursuitState]) -> Array:
        """``T_base_flange`` (n, 4, 4) for the tool at each of ``states``."""
        P = np.array([state.p for state in states])
        c, s = np.cos(P[:, 3])[:, None], np.sin(P[:, 3])[:, None]
        upright = self._upright_flange
        T = np.zeros((len(P), 4, 4))
        T[:, 0, :3] = c * upright[0, :3] - s * upright[1, :3]
        T[:, 1, :3] = s * upright[0, :3] + c * upright[1, :3]
        T[:, 2, :3] = upright[2, :3]
        T[:, 0, 3] = c[:, 0] * upright[0, 3] - s[:, 0] * upright[1, 3]
        T[:, 1, 3] = s[:, 0] * upright[0, 3] + c[:, 0] * upright[1, 3]
        T[:, 2, 3] = upright[2, 3]
        T[:, :3, 3] += P[:, :3]
        T[:, 3, 3] = 1.0
        return T

    def joints(self, state: PursuitState, near: Array) -> tuple[Array, Array]:
        """Joints (6,) and joint speeds (6,) for the tool at ``state``, on the branch of ``near`` (6,)."""
        q, qd = self.line([state], near)
        return q[0], qd[0]

    def walked(self, start: Array, goal: Array, near: Array) -> Array:
        """Joints (6,) for the tool at rest at ``goal`` (4,), found on a straight way from ``start`` (4,) with
        joints ``near`` (6,)."""
        count = int(np.ceil(float(np.linalg.norm((goal - start)[:3])) / _WALK_M)) + 1
        shares = np.linspace(0.0, 1.0, count + 1)[1:]
        Q, _ = self.line([PursuitState.still(start + share * (goal - start)) for share in shares], near)
        found: Array = Q[-1]
        return found

    def line(self, states: Sequence[PursuitState], near: Array) -> tuple[Array, Array]:
        """Joints (n, 6) and joint speeds (n, 6) for the tool at ``states``, from ``near`` (6,) on, or with
        guesses ``near`` (n, 6)."""
        T, first = self.flanges(states), near.reshape(-1, 6)[:1]
        Q = self._model.inverse_line(T, near)
        if Q is None or float(np.max(np.abs(np.diff(Q, axis=0, prepend=first)))) > _FARTHEST_RAD:
            places = (", ".join(f"{x:.3f}" for x in state.p[:3]) for state in (states[0], states[-1]))
            raise error("MOTION_UNREACHABLE", f"the tool at {' to '.join(dict.fromkeys(places))} m")
        V = np.array([state.v for state in states])
        lever = T[:, :3, 3] - np.array([state.p[:3] for state in states])
        twists = np.zeros((len(states), 6))
        twists[:, :3], twists[:, 5] = V[:, :3], V[:, 3]
        twists[:, 0] -= V[:, 3] * lever[:, 1]
        twists[:, 1] += V[:, 3] * lever[:, 0]
        Qd = np.asarray(np.linalg.solve(self._model.jacobian_many(Q), twists[:, :, None])[:, :, 0])
        return Q, Qd

    def fastest(self, leg: Leg, near: Array) -> Array:
        """The highest speed of each joint on the way of ``leg``, (6,) rad/s, from joints ``near`` (6,) on."""
        speeds: Array = np.max(np.abs(self.line(looks_along(leg), near)[1]), axis=0)
        return speeds

    def piece(self, t0: float, h: float, states: Sequence[tuple[Array, Array]]) -> TrajectoryPiece:
        """The polynomial through joints and joint speeds (6,) at ``t0``, ``t0 + h``, ... (Hermite)."""
        wanted = np.array([row for q, v in states for row in (q, h * v)])
        powers = h ** -np.arange(float(len(wanted)))
        coefficients = powers[:, None] * (_hermite(len(states)) @ wanted)
        return TrajectoryPiece(t0, t0 + h * (len(states) - 1), coefficients)


def looks_along(leg: Leg) -> list[PursuitState]:
    """The tool from the beginning of ``leg`` to its end, in steps of equal time."""
    return [leg.at(float(t)) for t in np.linspace(leg.t0, leg.t1, _LOOKS)]


def on_piece(piece: TrajectoryPiece, t: float) -> tuple[Array, Array]:
    """Joints (6,) and joint speeds (6,) of ``piece`` at ``t``; past its end, where it ends."""
    s, k = min(t, piece.t1) - piece.t0, np.arange(len(piece.coefficients))
    return s**k @ piece.coefficients, (k[1:] * s ** k[:-1]) @ piece.coefficients[1:]


def joints_on_piece(piece: TrajectoryPiece, t: float) -> Array:
    """The joints (6,) of :func:`on_piece` alone."""
    out: Array = along_piece(piece, np.array([t]))[0]
    return out


def along_piece(piece: TrajectoryPiece, times: Array) -> Array:
    """The joints (n, 6) of ``piece`` at ``times`` (n,); past its end, where it ends."""
    s = np.minimum(times, piece.t1) - piece.t0
    out: Array = s[:, None] ** np.arange(len(piece.coefficients)) @ piece.coefficients
    return out


def looks_on_piece(piece: TrajectoryPiece) -> tuple[Array, Array]:
    """Joints and joint speeds (n, 6) of ``piece`` from its beginning to its end, in steps of equal time."""
    times = np.linspace(piece.t0, piece.t1, _LOOKS)
    k = np.arange(1.0, len(piece.coefficients))
    speeds: Array = (k * (times - piece.t0)[:, None] ** (k - 1.0)) @ piece.coefficients[1:]
    return along_piece(piece, times), speeds


def fastest_on_piece(piece: TrajectoryPiece) -> Array:
    """The highest speed of each joint in ``piece``, (6,) rad/s."""
    speeds: Array = np.max(np.abs(looks_on_piece(piece)[1]), axis=0)
    return speeds


@lru_cache
def _hermite(nodes: int) -> Array:
    """(2 n, 2 n): from values and slopes at 0, 1, ... n - 1 to coefficients, lowest power first."""
    u, k = np.arange(float(nodes))[:, None], np.arange(2.0 * nodes)
    slopes = k * u ** np.maximum(k - 1.0, 0.0)
    return np.asarray(np.linalg.inv(np.stack([u**k, slopes], axis=1).reshape(2 * nodes, -1)))
