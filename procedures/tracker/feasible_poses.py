"""Which poses of an arm can be measured: within its ranges, free of collisions, and seen by the tracker."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from calibration.identification.model import Model, Targets, make_model
from calibration.kinematics.families import ArmSpec, arm_spec
from cell.errors import CellError, error
from cell.formats.robot import parse_robot
from cell.guard import PLANNED_CLEAR_M, MotionGuard
from cell.poses import Array, from_pose6
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.line_of_sight import REASONS, LineOfSight
from procedures.tracker.occlusion import Shape, shape_of

ASSUMED_RANGE_M = 3.5  # while the tracker's place is unknown
_BATCH = 4000
_TRIES = 80_000
_LOOKED_AT = 4  # times the candidates that are wanted, in one batch


def robot_of(values: RunValues, config: TrackerSamplingConfig) -> dict[str, Any]:
    """The ROBOT as its controller believes it, with the reflectors of the job as its tool.

    ``OBSERVED_MODEL_MISSING`` when the model of the observed arm is not configured.
    """
    given = values.robot if config.arm == "arm" else values.observed_robot
    if not given:
        raise error("OBSERVED_MODEL_MISSING")
    robot = {key: value for key, value in given.items() if key != "tool"}
    places = {name: list(r.point) for name, r in config.reflectors.items()}
    if robot.get("family") == "palletizer4":
        own = dict(zip(("tx", "ty", "tz"), places.pop("smr1", [0.0] * 3), strict=True))
        robot["parameters"] = {**robot["parameters"], **own}
    return {**robot, "tool": places} if places else robot


def payload_of(config: TrackerSamplingConfig, values: RunValues) -> float:
    """What hangs on the flange, kg."""
    return float(values.payload_kg if config.payload_kg is None else config.payload_kg)


@dataclass(frozen=True, eq=False)
class Space:
    """One arm with its reflectors, in front of one tracker; ``view`` None: its place is not known yet.

    ``ranges`` (j, 2) rad; ``guard`` only for an arm that we move, ``shape`` where one is known. Joints are
    the controller's.
    """

    spec: ArmSpec
    model: Model
    ranges: Array
    guard: MotionGuard | None
    shape: Shape | None
    view: LineOfSight | None
    noise: Mapping[str, float]
    refused: Counter[str] = field(default_factory=Counter)

    def points(self, Q: Array, target: Targets) -> Array:
        """(n, 3): where the nominal arm puts the reflectors, in the base."""
        return self.model.points(self.model.nominal, Q, target).T

    def flange(self, Q: Array) -> Array:
        """(n, 4, 4): the nominal arm's flange."""
        return self.spec.arm.base.flange(Q)

    def promise(self, Q: Array, target: Targets) -> Array:
        """(n,) m: a reading's standard deviation along one axis, NaN where the pose is not possible."""
        sigma = np.full(len(Q), np.nan)
        inside = np.all((self.ranges[:, 0] <= Q) & (self.ranges[:, 1] >= Q), axis=1)
        seen = np.flatnonzero(inside)
        seen = seen[self._seen(Q[seen], target[seen])]
        free = seen[self._free(Q[seen])]
        if len(free):
            sigma[free] = self.sigma(Q[free], target[free])
        return sigma

    def sigma(self, Q: Array, target: Targets) -> Array:
        """(n,) m: the noise at the range of each reflector."""
        if self.view is None:
            return np.full(len(Q), self.noise["sigma0"] + self.noise["sigma_per_m"] * ASSUMED_RANGE_M)
        return self.view.sigma(self.points(Q, target), self.noise)

    def candidates(self, count: int, rng: np.random.Generator, hub: Array) -> tuple[Array, Targets]:
        """``count`` poses (c, j) that are possible, and their reflectors (c,); fewer where few are.

        The way there from ``hub`` (j,) is free, so there is one between any two of them.
        """
        found: list[Array] = []
        which: list[Targets] = []
        have = tried = 0
        while have < count and tried < _TRIES:
            Q = self._spread(rng, _BATCH)
            target = rng.integers(0, len(self.model.targets), _BATCH)
            tried += _BATCH
            seen = np.flatnonzero(self._seen(Q, target, self.refused))[: _LOOKED_AT * count]
            for k in seen[self._free(Q[seen], self.refused)]:
                if self._got_to(hub, Q[k]):
                    found.append(Q[k])
                    which.append(target[k])
                    have += 1
                    if have == count:
                        break
        self.refused["tried"] += tried
        return np.array(found).reshape(have, len(self.ranges)), np.array(which, dtype=np.int64)

    def anywhere(self, count: int, rng: np.random.Generator) -> Array:
        """(count, j): poses that the arm can take, seen or not: where its predictions shall be good."""
        out = np.zeros((0, len(self.ranges)))
        for _ in range(_TRIES // _BATCH):
            Q = self._spread(rng, 2 * count)
            out = np.concatenate([out, Q[self._free(Q)]])
            if len(out) >= count:
                break
        return out[:count]

    def why_not(self) -> str:
        """What kept most of the tried poses out, most frequent first."""
        tried = self.refused["tried"]
        reasons = sorted(((n, why) for why, n in self.refused.items() if why != "tried"), reverse=True)
        return "; ".join(f"{100 * n / max(tried, 1):.1f} % {why}" for n, why in reasons if n)

    def check_path(self, q0: Array, q1: Array) -> None:
        """Raise the coded error that forbids this joint path; an arm that we do not move has none.

        A fault may stop the arm anywhere on it, and the next run has to get away from there.
        """
        if self.guard is not None:
            self.guard.check_path_joints(q0, q1, PLANNED_CLEAR_M)

    def check_way(self, q0: Array, q1: Array) -> None:
        """As :meth:`check_path` for a way that was not planned, or whose start is measured: just as much is
        kept as lies between two samples of a path."""
        if self.guard is not None:
            self.guard.check_path_joints(q0, q1, 0.5 * PLANNED_CLEAR_M)

    def link_ends(self, Q: Array) -> Array | None:
        """(n, k, 2, 3): the links at joints (n, j), as :meth:`.LineOfSight.hidden` takes them, or None."""
        return None if self.shape is None else self.shape.ends(Q)

    def check_start(self, q: Array) -> None:
        """Raise the coded error that keeps an arm, which is measured at ``q`` (j,), from being moved."""
        if self.guard is not None:
            self.guard.check_standing(q)

    def _got_to(self, hub: Array, q: Array) -> bool:
        try:
            self.check_path(hub, q)
        except CellError:
            self.refused["no free way there"] += 1
            return False
        return True

    def _spread(self, rng: np.random.Generator, count: int) -> Array:
        out: Array = rng.uniform(self.ranges[:, 0], self.ranges[:, 1], (count, len(self.ranges)))
        return out

    def _seen(self, Q: Array, target: Targets, count: Counter[str] | None = None) -> NDArray[np.bool_]:
        """(n,): whether the tracker sees the reflector; always, while its place is not known."""
        if self.view is None or not len(Q):
            return np.ones(len(Q), dtype=bool)
        p = self.points(Q, target)
        fault = self.view.faults(self.flange(Q), p, target)
        seen = np.flatnonzero(fault < 0)
        if len(seen):
            fault[seen[self.view.hidden(p[seen], self.link_ends(Q[seen]))]] = 3
        if count is not None:
            count.update(REASONS[code] for code in fault[fault >= 0])
        good: NDArray[np.bool_] = fault < 0
        return good

    def _free(self, Q: Array, count: Counter[str] | None = None) -> NDArray[np.bool_]:
        """(n,): where the guard lets the arm be; everywhere, if we do not move it."""
        if self.guard is None or not len(Q):
            return np.ones(len(Q), dtype=bool)
        free = self.guard.free(Q, PLANNED_CLEAR_M)
        if count is not None:
            count["boxes, floor or the arm itself are in the way"] += int(np.sum(~free))
        return free


def make_space(
    values: RunValues,
    config: TrackerSamplingConfig,
    noise: Mapping[str, float],
    T_base_tracker: Sequence[float] | None,
) -> Space:
    """The space of a run; ``T_base_tracker`` (pose6) None while the tracker's place is unknown."""
    spec = arm_spec(parse_robot(robot_of(values, config), "robot"))
    guard = lease_settings(values)[0] if config.arm == "arm" else None
    joints = spec.arm.joints
    ranges = np.array(config.joint_ranges_rad or np.tile([-np.pi, np.pi], (joints, 1)), dtype=float)
    if ranges.shape != (joints, 2):
        raise error(
            "ARGUMENT_INVALID", f"joint_ranges_rad has {len(ranges)} entries; the arm has {joints} joints"
        )
    if guard is not None:
        limits = guard.model.joint_limits
        low, high = np.maximum(ranges[:, 0], limits[:, 0]), np.minimum(ranges[:, 1], limits[:, 1])
        ranges = np.column_stack([low, high])
    model = make_model(spec, list(config.reflectors))
    place = None if T_base_tracker is None else from_pose6(T_base_tracker)
    shape = shape_of(spec, guard, config.sight.link_radius_m)
    view = None if place is None else _view(place, config, guard, shape)
    return Space(spec, model, ranges, guard, shape, view, dict(noise))


def _view(
    place: RigidTransform, config: TrackerSamplingConfig, guard: MotionGuard | None, shape: Shape | None
) -> LineOfSight:
    boxes = [] if guard is None else [(box.low, box.high) for box in guard.limits.keep_out]
    radii = np.zeros(0) if shape is None else shape.radii
    return LineOfSight(place, config.sight, list(config.reflectors.values()), radii, boxes)
