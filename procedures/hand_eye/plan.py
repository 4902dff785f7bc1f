"""Planning for the worker process: plain values in, a plan out. Nothing here touches a device."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.hand_eye import se3
from calibration.hand_eye.closed_form import closed_form_X
from calibration.hand_eye.pnp import solve_pnp
from calibration.hand_eye.problem import Problem, Setup
from calibration.hand_eye.views import CornerSet
from calibration.planning import (
    ConeRequest,
    ConeShape,
    EyeInHand,
    EyeToHand,
    Mounting,
    plan_telling_cone,
    search_moves,
)
from calibration.targets import make_target
from cell.devices import Intrinsics
from cell.errors import error
from cell.poses import Array, from_pose6, to_pose6
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings
from procedures.hand_eye.advice import lost_text, where_to_move
from procedures.hand_eye.prediction import CapturePrediction

MIN_VIEWS = 4
MOST_LOST = 0.5  # of the poses of a placement; a board that loses more is badly placed


@dataclass(frozen=True)
class BoardObservation:
    """The board seen once: joints, flange pose, and corners ``ids`` (n,) with pixels (n, 2)."""

    q: list[float]
    T_base_flange: list[float]
    ids: list[int]
    corners: list[list[float]]
    camera: dict[str, Any]

    @classmethod
    def from_observation(
        cls, observation: Mapping[str, Any], camera: Mapping[str, Any]
    ) -> "BoardObservation":
        """The first frame of a finished pose."""
        corners = observation["frames"][0]["corners"]
        seen = [(i, uv) for i, uv in enumerate(corners) if uv is not None]
        return cls(
            list(observation["q"]),
            list(observation["T_base_flange"]),
            [i for i, _ in seen],
            [uv for _, uv in seen],
            dict(camera),
        )

    @classmethod
    def of_board(cls, board: Mapping[str, Any], camera: Mapping[str, Any]) -> "BoardObservation":
        """What :meth:`board` was made of."""
        return cls(**board, camera=dict(camera))

    def board(self) -> dict[str, Any]:
        """What tells later whether the board still lies there."""
        return {"ids": self.ids, "corners": self.corners, "q": self.q, "T_base_flange": self.T_base_flange}

    def intrinsics(self) -> Intrinsics:
        c = self.camera
        return Intrinsics(c["width"], c["height"], tuple(c["K"]), tuple(c["dist"]))


@dataclass(frozen=True)
class PlanRequest:
    """One placement to plan. ``calibration`` holds X, or W of an eye-to-hand setup, as six numbers each."""

    setup: Setup
    values: RunValues
    target: dict[str, Any]
    calibration: dict[str, Any]
    view: BoardObservation
    poses: int
    min_poses: int
    cone_half_angle_rad: float
    distance_m: float
    finished: list[int]
    placements: int
    second_distance_m: float | None = None


@dataclass(frozen=True)
class Visit:
    """One pose to visit; ``index`` is its place on the cone."""

    index: int
    q: list[float]


@dataclass(frozen=True)
class PlacementPlan:
    """The poses in their order, and everything a person wants to see of the plan."""

    poses: list[Visit]
    listing: dict[str, Any]
    poor: str = ""  # why most poses are lost, and what would help

    def as_dict(self) -> dict[str, Any]:
        return self.listing


def target_point_count(target: Mapping[str, Any]) -> int:
    """How many points the target has."""
    return len(make_target(target).points)


def plan_placement(request: PlanRequest) -> PlacementPlan:
    """Plan one placement around the board as it is seen; ``PLAN_INFEASIBLE`` with the reasons."""
    view, values = request.view, request.values
    guard, _, _ = lease_settings(values)
    points = make_target(request.target).points
    seen = camera_to_target(view, points)
    flange = from_pose6(view.T_base_flange)
    mounting = mounting_of(request.setup, request.calibration, flange, seen)
    cone = ConeRequest(
        mounting=mounting,
        shape=ConeShape(
            request.poses, request.cone_half_angle_rad, request.distance_m, request.second_distance_m
        ),
        target_points=points,
        intrinsics=view.intrinsics(),
        T_camera_target=seen,
        q_start=np.array(view.q),
        skip=frozenset(request.finished),
    )
    prediction = CapturePrediction.of(
        request.setup,
        mounting,
        view.intrinsics(),
        points,
        values,
        request.target,
        view.camera.get("sigma"),
        request.placements,
    )
    plan = plan_telling_cone(
        cone,
        guard.model,
        guard.check_path_joints,
        lambda plan: prediction.error_at(plan, request.distance_m),
    ).described(lambda q: guard.describe(q).as_dict())
    needed = max(request.min_poses - len(request.finished), 0)
    short = None if request.finished else plan.shortfall(needed)
    poor = ""
    few = int(np.ceil(MOST_LOST * (request.poses - len(request.finished))))
    if short is not None or len(plan.poses) < few:
        poor = lost_text(plan.rejected, request.poses)
        if short is not None and len(plan.poses) >= needed:  # enough poses, and they tell too little
            poor = short.detail
        poor += f": {where_to_move(cone, guard.model, guard.check_path_joints, max(few, needed))}"
    if short is not None:
        raise error(short.name, poor)
    listing = plan.as_dict()
    if len(plan.poses) >= MIN_VIEWS:
        listing["predicted"] = prediction.told(plan)
    return PlacementPlan([Visit(p.index, [float(v) for v in p.q]) for p in plan.poses], listing, poor)


def plan_search(values: RunValues, view: BoardObservation) -> list[list[float]]:
    """Joints of up to six small checked moves about the present pose."""
    guard, _, _ = lease_settings(values)
    start = from_pose6(view.T_base_flange)
    moves = search_moves(guard.model, guard.check_path_joints, np.array(view.q), start)
    return [[float(v) for v in move.q] for move in moves]


def refine_calibration(
    setup: Setup, target: Mapping[str, Any], views: Sequence[BoardObservation]
) -> dict[str, Any]:
    """X from views of one placement by the closed form: good enough to plan with."""
    if len(views) < MIN_VIEWS:
        raise error("SOLVE_REFUSED", f"{len(views)} views of the board, {MIN_VIEWS} are needed to plan with")
    points = make_target(target).points
    F = np.stack([from_pose6(v.T_base_flange).as_matrix() for v in views])
    C = np.stack([camera_to_target(v, points).as_matrix() for v in views])
    n = len(views)
    bare = np.zeros(n)
    problem = Problem(
        setup,
        se3.inverse(F) if setup == "eye-in-hand" else F,
        C,
        np.zeros(n, dtype=np.int64),
        np.zeros((n, 6, 6)),
        bare,
        bare,
    )
    return {"X": [float(v) for v in to_pose6(RigidTransform.from_matrix(closed_form_X(problem)))]}


def camera_to_target(view: BoardObservation, points: Array) -> RigidTransform:
    """``T_camera_target`` of one view; the better of the two poses that a plane allows."""
    corner_view = CornerSet(points[view.ids], np.array(view.corners), np.ones(len(view.ids)))
    poses, _ = solve_pnp([corner_view], view.intrinsics())
    return RigidTransform.from_matrix(poses.C[0])


def mounting_of(
    setup: Setup, calibration: Mapping[str, Any], flange: RigidTransform, seen: RigidTransform
) -> Mounting:
    if setup == "eye-in-hand":
        return EyeInHand.from_view(from_pose6(calibration["X"]), flange, seen)
    if "X" in calibration:
        # The board was remounted since, so where it sits on the flange is told by what is seen now.
        return EyeToHand.from_view(flange.inv() * from_pose6(calibration["X"]) * seen, flange, seen)
    return EyeToHand.from_view(from_pose6(calibration["W"]), flange, seen)
