"""The one physical world of the twin; its state is a function of time.

The controller knows the arm by its *believed* chain and reports that; cameras and trackers see the *true*
one: other links where the scenario has errors, and a small deviation that is new at every standstill.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.devices import Intrinsics
from cell.poses import Array, exp_xi, from_pose6, to_pose6
from fakes.kinematics import chain
from fakes.scenario import Obstacle, Scenario, WorldTruth
from fakes.segments import Segment
from fakes.track import Track

Message = tuple[Any, ...]  # what keeps a mirror in step; picklable


@dataclass(frozen=True)
class Scene:
    """What is truly where at ``t``; ``None`` while the target is not in the cell."""

    t: float
    placement: int | None
    T_base_flange: RigidTransform
    T_base_camera: RigidTransform
    T_base_target: RigidTransform | None
    T_camera_target: RigidTransform | None


class Operator:
    """The person who puts the target where the job wants it; a change is an event in time."""

    def __init__(self, t: float, placements: int) -> None:
        self.placements = placements
        self.listeners: list[Callable[[float, int | None], None]] = []
        self._times, self._where = [t], [0 if placements else None]

    def confirm(self, placement: int, t: float) -> None:
        """From ``t`` on the target is at ``placement`` (counted from 0)."""
        if not 0 <= placement < self.placements:
            raise ValueError(f"placement {placement} does not exist, the scenario has {self.placements}")
        self._put(placement, t)

    def move_on(self, t: float) -> int:
        """Put the target at the next placement, after the last one at the first; returns its number."""
        last = next((p for p in reversed(self._where) if p is not None), -1)
        self.confirm((last + 1) % self.placements, t)
        return (last + 1) % self.placements

    def remove(self, t: float) -> None:
        """Take the target out of the cell at ``t``."""
        self._put(None, t)

    def put_back(self, t: float) -> None:
        """Put the target back where it was last."""
        self._put(next((p for p in reversed(self._where) if p is not None), 0), t)

    def placement_at(self, t: float) -> int | None:
        """Where the target is at ``t``, or None."""
        return self._where[max(bisect_right(self._times, t) - 1, 0)]

    def history(self) -> list[tuple[float, int | None]]:
        """All changes, oldest first."""
        return list(zip(self._times, self._where, strict=True))

    def load(self, history: list[tuple[float, int | None]]) -> None:
        """Become a copy of the operator whose :meth:`history` this is."""
        self._times, self._where = [t for t, _ in history], [where for _, where in history]

    def follow(self, t: float, placement: int | None) -> None:
        """Do at ``t`` what the operator of the mirrored world did."""
        self._put(placement, t)

    def _put(self, placement: int | None, t: float) -> None:
        keep = max(bisect_right(self._times, t), 1)
        self._times[keep:], self._where[keep:] = [t], [placement]
        for listener in tuple(self.listeners):
            listener(t, placement)


class _Repeatability:
    """How far the true flange is off the reported one: a draw at each standstill, blended while moving."""

    def __init__(self, seed: int, sigma_t: float, sigma_r: float) -> None:
        self._seed, self._sigma = seed, np.array([sigma_t] * 3 + [sigma_r] * 3)
        self._moves: deque[tuple[float, float]] = deque([(-np.inf, -np.inf)], maxlen=256)

    def add(self, segment: Segment) -> None:
        while len(self._moves) > 1 and self._moves[-1][0] >= segment.t0:
            self._moves.pop()
        if segment.settles:
            self._moves.append((segment.t0, segment.t_end))

    def moves(self) -> list[tuple[float, float]]:
        return list(self._moves)

    def load(self, moves: list[tuple[float, float]]) -> None:
        self._moves = deque(moves, maxlen=self._moves.maxlen)

    def at(self, t: float) -> Array:
        """Deviation (6,), translation first, m and rad, in the flange."""
        i = max(bisect_right([m[0] for m in self._moves], t) - 1, 0)
        start, end = self._moves[i]
        now = self._draw(start)
        if i == 0 or t >= end:
            return now
        part = (t - start) / (end - start)
        return part * now + (1.0 - part) * self._draw(self._moves[i - 1][0])

    def _draw(self, start: float) -> Array:
        key = 0 if start == -np.inf else round(start * 1e6) + 1
        return self._sigma * np.random.default_rng([self._seed, key]).standard_normal(6)


class World:
    """Arm, camera, target and obstacles as they truly are."""

    def __init__(self, truth: WorldTruth, t0: float) -> None:
        self.config, self.t0 = truth, t0
        factory = truth.arm.factory.deltas()
        self.believed = chain(truth.arm.model, factory)
        self.true = chain(truth.arm.model, factory + truth.arm.error.deltas())
        self.track = Track(t0, truth.arm.q_start)
        self.T_flange_tool = from_pose6(truth.tool.T_flange_tool)
        self.target = truth.target
        camera = truth.camera
        self.eye_in_hand = truth.eye_in_hand
        self.T_mount_camera = from_pose6(truth.camera_mount)
        fx, fy, cx, cy = camera.K
        self.intrinsics = Intrinsics(camera.width, camera.height, (fx, fy, cx, cy), tuple(camera.dist))
        self.T_mount_target = [from_pose6(pose) for pose in truth.target_mounts]
        self.operator = Operator(t0, len(self.T_mount_target))
        self._repeatability = _Repeatability(
            truth.seed, truth.arm.repeatability_t_m, truth.arm.repeatability_r_rad
        )
        self.track.listeners.append(self._repeatability.add)

    @classmethod
    def from_scenario(cls, scenario: Scenario, t0: float = 0.0) -> "World":
        """The world of ``scenario`` as it stands at ``t0`` seconds on the twin's clock."""
        return cls(scenario.world, t0)

    def mirror_to(self, send: Callable[[Message], None]) -> None:
        """Hand ``send`` the state and then every change; by :meth:`apply` another world follows."""
        segments = self.track.snapshot()
        send(("state", segments, self._repeatability.moves(), self.operator.history()))
        self.track.listeners.append(lambda segment: send(("segment", segment)))
        self.operator.listeners.append(lambda t, placement: send(("placement", t, placement)))

    def apply(self, message: Message) -> None:
        """Follow one message of another world's :meth:`mirror_to`."""
        match message:
            case ("segment", segment):
                self.track.append(segment)
            case ("placement", t, placement):
                self.operator.follow(t, placement)
            case ("state", segments, moves, history):
                self.track.load(segments)
                self._repeatability.load(moves)
                self.operator.load(history)
            case _:
                raise ValueError(f"a world does not know the message {message[0]!r}")

    def believed_flange(self, t: float) -> RigidTransform:
        """``T_base_flange`` as the controller computes it."""
        return self.believed.forward(self.track.at(t)[0])

    def true_flange(self, t: float) -> RigidTransform:
        """``T_base_flange`` as it truly is."""
        return self.true.forward(self.track.at(t)[0]) * exp_xi(self._repeatability.at(t))

    def scene(self, t: float) -> Scene:
        """The true poses at ``t``."""
        flange = self.true_flange(t)
        placement = self.operator.placement_at(t)
        mount = None if placement is None else self.T_mount_target[placement]
        if self.eye_in_hand:
            camera, target = flange * self.T_mount_camera, mount
        else:
            camera, target = self.T_mount_camera, None if mount is None else flange * mount
        seen = None if target is None else camera.inv() * target
        return Scene(t, placement, flange, camera, target, seen)

    def contact_force(self, t: float, T_flange_tcp: RigidTransform) -> Array:
        """Force (N) and moment (Nm) of obstacles on the tool's tip, (6,), in the base."""
        force = np.zeros(6)
        if self.config.obstacle:
            tip = (self.true_flange(t) * T_flange_tcp).translation
            for obstacle in self.config.obstacle:
                force[:3] += _push(obstacle, tip)
        return force

    def truth(self) -> dict[str, Any]:
        """Everything a result may be judged against, as plain JSON values."""
        camera, target = (
            ("T_flange_camera", "T_base_target") if self.eye_in_hand else ("T_base_camera", "T_flange_target")
        )
        return {
            "schema": "cellward.truth/1",
            "setup": "eye-in-hand" if self.eye_in_hand else "eye-to-hand",
            camera: to_pose6(self.T_mount_camera).tolist(),
            target: [to_pose6(T).tolist() for T in self.T_mount_target],
            "T_flange_tool": to_pose6(self.T_flange_tool).tolist(),
            "camera": self.config.camera.model_dump(include={"serial", "width", "height", "K", "dist"}),
            "target": self.target,
            "robot": {
                "model": self.config.arm.model,
                "serial": self.config.arm.serial,
                "factory": self.config.arm.factory.model_dump(),
                "error": self.config.arm.error.model_dump(),
            },
            "noise": {
                "sigma_px": self.config.camera.noise_px,
                "sigma_flange_t": self.config.arm.repeatability_t_m,
                "sigma_flange_r": self.config.arm.repeatability_r_rad,
            },
        }


def _push(obstacle: Obstacle, tip: Array) -> Array:
    normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
    depth = float(normal @ (np.array(obstacle.point) - tip))
    force: Array = normal * (obstacle.stiffness_n_m * max(depth, 0.0))
    return force
