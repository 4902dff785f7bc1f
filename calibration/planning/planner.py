"""Plan the cone poses of one placement: reachable, in view, free to move between, in a short order."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.planning.cone import ConeAxis, ConeShape, board_centre, candidate_axes, cone_poses
from calibration.planning.mounting import Mounting
from calibration.planning.plan import ConePlan, PlannedPose, RejectedPose
from calibration.planning.view import view_faults
from cell.arm_model import ArmModel
from cell.devices import Intrinsics
from cell.errors import CellError
from cell.poses import Array

Checker = Callable[[Array, Array], None]
"""``checker(q_from, q_to)`` raises a ``CellError`` when that joint path is not free."""

_OTHER_BRANCHES = 3
_OTHER_RAD = 0.5  # joints that differ by more are on another branch
_ALIKE = 6  # decimals of rad: turns that differ by less are as far


@dataclass(frozen=True, eq=False)
class ConeRequest:
    """What is wanted. ``T_camera_target`` is the board as seen at ``q_start``, where the arm also returns.

    ``axes`` None tries :func:`candidate_axes`; poses with an index in ``skip`` are not planned.
    """

    mounting: Mounting
    shape: ConeShape
    target_points: Array  # (m, 3) in the target frame
    intrinsics: Intrinsics
    T_camera_target: RigidTransform
    q_start: Array  # (6,) rad
    axes: Sequence[ConeAxis] | None = None
    margin_px: float = 40.0
    skip: Collection[int] = field(default_factory=frozenset)


def judged_once(checker: Checker) -> Checker:
    """``checker`` for plans that are alike: of each path it is asked once."""
    known: dict[tuple[bytes, bytes], CellError | None] = {}

    def check(q_from: Array, q_to: Array) -> None:
        path = q_from.tobytes(), q_to.tobytes()
        if path not in known:
            try:
                checker(q_from, q_to)
                known[path] = None
            except CellError as exc:
                known[path] = exc
        if (forbidden := known[path]) is not None:
            raise forbidden.with_traceback(None)

    return check


def plan_cone(request: ConeRequest, model: ArmModel, checker: Checker) -> ConePlan:
    """The best plan over all candidate axes: the first that loses no pose, else the one that loses fewest.

    Raises nothing for a poor plan: ask :meth:`ConePlan.shortfall`.
    """
    axes = request.axes or candidate_axes(request.T_camera_target, request.target_points)
    plans: list[ConePlan] = []
    for tried, axis in enumerate(axes, start=1):
        enough = len(max(plans, key=_merit).poses) if plans else 0
        views = cone_poses(axis.T_target_cone, request.shape).inv()
        tour = _Tour(request, views, model, checker, enough)
        plans.append(ConePlan(tour.visits(), tour.rejected, axis, tried))
        if not tour.rejected:
            break
    best = max(plans, key=_merit)
    return ConePlan(best.poses, best.rejected, best.axis, len(plans))


def plan_views(request: ConeRequest, views: RigidTransform, model: ArmModel, checker: Checker) -> ConePlan:
    """A plan of the given T_camera_target (n), in their order; ``request.shape`` has as many poses."""
    tour = _Tour(request, views, model, checker, 0)
    here = RigidTransform.from_translation(board_centre(request.target_points))
    return ConePlan(tour.visits(), tour.rejected, ConeAxis(here, "over the camera's volume"), 1)


def _merit(plan: ConePlan) -> tuple[int, float]:
    return len(plan.poses), round(plan.spread_rad, 2) - 1e-4 * plan.travel_rad


class _Tour:
    """One ring of views: visits it from the pose nearest to the start, and reports what is lost.

    It gives up early when it cannot visit more than ``to_beat`` poses.
    """

    def __init__(
        self, request: ConeRequest, views: RigidTransform, model: ArmModel, checker: Checker, to_beat: int
    ) -> None:
        self._to_beat = to_beat
        self._request, self._model, self._checker = request, model, checker
        self._views = views
        self._flanges = request.mounting.flange(self._views)
        self._visits: list[tuple[int, Array]] = []
        self._lost: dict[int, str] = {}
        self._walk()
        self._return()

    @property
    def rejected(self) -> list[RejectedPose]:
        return [RejectedPose(k, why) for k, why in sorted(self._lost.items())]

    def visits(self) -> list[PlannedPose]:
        """The poses in order."""
        before = [self._request.q_start, *(q for _, q in self._visits)]
        return [
            PlannedPose(
                index=k,
                q=q,
                T_base_flange=self._flanges[k],
                T_camera_target=self._views[k],
                travel_rad=float(np.max(np.abs(q - last))),
            )
            for (k, q), last in zip(self._visits, before[:-1], strict=True)
        ]

    @property
    def _here(self) -> Array:
        return self._visits[-1][1] if self._visits else self._request.q_start

    def _walk(self) -> None:
        request = self._request
        faults = view_faults(self._views, request.target_points, request.intrinsics, request.margin_px)
        wanted = [k for k in range(request.shape.poses) if k not in request.skip]
        self._lost = {k: fault for k in wanted if (fault := faults[k]) is not None}
        lap_of = request.shape.lap_of()
        blocked: list[int] = []
        for lap in range(request.shape.laps):
            now = self._views[self._visits[-1][0]] if self._visits else request.T_camera_target
            own = [k for k in wanted if k not in self._lost and lap_of[k] == lap]
            ring = _from_nearest(own, self._views, now)
            if lap > 0 and request.shape.other_branch:
                ring = self._change_branch(ring)
            blocked += [k for k in ring if self._pass(k)]
        # What was blocked on the way may be free from the other side, or with the arm on another branch.
        for n, k in enumerate(reversed(blocked)):
            if len(self._visits) + len(blocked) - n <= self._to_beat:
                return
            branches = sorted(self._model.inverse_all(self._flanges[k]), key=self._distance)
            self._visit(k, branches[:_OTHER_BRANCHES])

    def _change_branch(self, ring: list[int]) -> list[int]:
        """Visit the first pose of ``ring`` that can be reached on another branch, and give back the others;
        the arm stays on that branch then, since it goes on to the nearest joints."""
        for n, k in enumerate(ring):
            near = self._model.inverse(self._flanges[k], self._here)
            others = [
                q
                for q in self._model.inverse_all(self._flanges[k])
                if near is None or float(np.max(np.abs(q - near))) > _OTHER_RAD
            ]
            if self._visit(k, sorted(others, key=self._distance)[:_OTHER_BRANCHES]):
                return ring[n + 1 :] + ring[:n]
        return ring

    def _pass(self, k: int) -> bool:
        """Visit a pose in passing; True when something blocked it that may be got round."""
        q = self._model.inverse(self._flanges[k], self._here)
        if q is None:
            self._lost[k] = "out of the arm's reach or joint range"
            return False
        return not self._visit(k, [q])

    def _distance(self, q: Array) -> float:
        return float(np.linalg.norm(q - self._here))

    def _visit(self, k: int, solutions: Sequence[Array]) -> bool:
        """Go to pose ``k`` by the first of the joint vectors that is free, or note why none is."""
        for q in solutions:
            try:
                self._checker(q, q)  # most poses fail where they are, and that is quickly known
                self._checker(self._here, q)
            except CellError as exc:
                self._lost[k] = exc.detail
                continue
            self._visits.append((k, q))
            self._lost.pop(k, None)
            return True
        return False

    def _return(self) -> None:
        """Give up poses from the end until the way back to the start is free."""
        while self._visits:
            try:
                self._checker(self._here, self._request.q_start)
            except CellError as exc:
                k, _ = self._visits.pop()
                self._lost[k] = f"no free way back to the start: {exc.detail}"
            else:
                return


def _from_nearest(ring: list[int], views: RigidTransform, now: RigidTransform) -> list[int]:
    """The ring turned so that it begins with the view closest to the present one; of those that are as close,
    as before a target that is faced squarely, the first one, and not the one that rounding prefers."""
    if not ring:
        return []
    apart = (views.inv() * now).rotation.magnitude()
    first = int(np.argmin(np.round(apart[ring], _ALIKE)))
    return ring[first:] + ring[:first]
