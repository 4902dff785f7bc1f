"""Planning for the worker process: plain values in, a plan out. Nothing here touches a device.

Poses are chosen for the predictions of the solved arm (``calibration.identification.selection``) among those
that are free and seen. Some more are set aside, taken at random: they judge the result and never solve it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.estimator import Problem
from calibration.identification.model import Targets
from calibration.identification.observability import Observability, observe, refuse
from calibration.identification.reflector_constant import KEY, open_constant
from calibration.identification.selection import (
    RULE_ANGLE,
    SourceRule,
    choose,
    choose_poses,
    make_design,
    source_rule,
)
from calibration.identification.solution import base_covariance
from calibration.lengths import lengths95
from cell.errors import CellError, error
from cell.poses import Array
from cell.run_values import RunValues
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import Space, make_space
from procedures.tracker.rule_of_thumb import require_kept, rule_cost, rule_entry, rule_text, short_steps
from procedures.tracker.visit_order import FarSteps, blocked, tour

_CANDIDATES = 8  # for each pose of the plan
_LEAST_CANDIDATES = 120
_VALIDATION = 120
_NEAR_RAD = 0.35  # joints around the start pose, while the tracker's place is unknown
_NEAR_DRAWS = 200
_SAME_FACING_RAD = 0.3
_AHEAD = 1.0 + 1e-9
_EXCHANGES = 40  # of poses that no order keeps to the rule of thumb


@dataclass(frozen=True)
class PlanRequest:
    """What a plan is made from. ``measured`` are poses that a run before this one finished: joints, reflector
    and whether it was set aside. ``stored`` are joints and reflectors of a set that is solved with them.
    ``T_base_tracker`` None: the tracker's place is not known yet.
    """

    values: RunValues
    config: dict[str, Any]
    noise: dict[str, float]
    T_base_tracker: list[float] | None
    q_start: list[float]
    measured: list[tuple[list[float], str, bool]] = field(default_factory=list)
    stored: list[tuple[list[float], str]] = field(default_factory=list)


@dataclass(frozen=True)
class Visit:
    """One pose to measure; ``via`` (no or one) are joints to go by on the way there."""

    q: list[float]
    reflector: str
    held_out: bool
    via: list[list[float]]


@dataclass(frozen=True)
class SamplingPlan:
    """``locate`` come first, to find the tracker's place; ``listing`` is everything a person wants to see.

    Ways that are not free directly meet at the joints ``hub``.
    """

    visits: list[Visit]
    locate: list[Visit]
    listing: dict[str, Any]
    hub: list[float]


def plan_sampling(request: PlanRequest) -> SamplingPlan:
    """The poses in their order; ``TRACKER_PLAN_REFUSED`` or ``TRACKER_PLAN_UNOBSERVABLE`` with the reason."""
    config = TrackerSamplingConfig.model_validate(request.config)
    space = make_space(request.values, config, request.noise, request.T_base_tracker)
    return _Planner(request, config, space).plan()


@dataclass(frozen=True, eq=False)
class _Poses:
    """Joints ``q`` (n, j), reflectors ``target`` (n,), and which are set aside (n,)."""

    q: Array
    target: Targets
    held_out: NDArray[np.bool_]

    def take(self, rows: list[int]) -> "_Poses":
        return _Poses(self.q[rows], self.target[rows], self.held_out[rows])


class _Planner:
    def __init__(self, request: PlanRequest, config: TrackerSamplingConfig, space: Space) -> None:
        self._request, self._config, self._space = request, config, space
        self._rng = np.random.default_rng(0)
        self._start = np.array(request.q_start, dtype=float)
        names = list(config.reflectors)
        solving = [(q, name) for q, name, aside in request.measured if not aside]
        done = [*request.stored, *solving]
        joints = space.spec.arm.joints
        self._done_q = np.array([q for q, _ in done], dtype=float).reshape(len(done), joints)
        self._gear = np.max(np.abs(space.spec.arm.base.coupling), axis=0)
        self._done_target = np.array([names.index(name) for _, name in done], dtype=np.int64)
        self._candidates: tuple[Array, Targets] = self._done_q[:0], self._done_target[:0]
        aside = sum(held for _, _, held in request.measured)
        self._held = max(config.held_out - aside, 0)
        self._count = max(config.poses - config.held_out - len(solving), 0)

    def plan(self) -> SamplingPlan:
        space, config = self._space, self._config
        try:
            space.check_start(self._start)
        except CellError as why:
            text = f"the arm stands where it may not be, move it by hand: {why.detail}"
            raise error("TRACKER_PLAN_REFUSED", text) from why
        validation = space.anywhere(_VALIDATION, self._rng)
        if len(validation) < 2:
            raise error("TRACKER_PLAN_REFUSED", "the arm is nowhere free within joint_ranges_rad and boxes")
        chosen, random_rms = self._chosen(validation)
        locate = self._locate()
        start = self._start if not locate else np.array(locate[-1].q)
        if config.keep_rule:
            chosen = self._with_far_steps(start, chosen, validation)
        order, lost = self._ordered(start, chosen, config.keep_rule)
        by_rule = None
        if config.keep_rule:
            shortest, _ = self._ordered(start, chosen, by_rule=False)
            limits = None if space.guard is None else self._request.values.limits
            path, least = (self._path(start, chosen.q, rows) for rows in (order, shortest))
            by_rule = rule_cost(path, least, limits)
        chosen = chosen.take([row for row, _ in order])
        Q, target, held = chosen.q, chosen.target, chosen.held_out
        visits = [
            self._visit(q, t, h, by_hub) for q, t, h, (_, by_hub) in zip(Q, target, held, order, strict=True)
        ]
        solving = np.concatenate([self._done_q, Q[~held]])
        solving_target = np.concatenate([self._done_target, target[~held]])
        observed = self._observed(solving, solving_target)
        predicted = self._predicted(solving, solving_target, validation)
        rule = source_rule(solving * self._gear)
        if config.keep_rule:
            to_come = np.concatenate([self._done_q[-1:], Q[~held]])  # what is measured stays as it is
            require_kept(rule.poses, to_come * self._gear, space.ranges * self._gear[:, None], lost)
        self._hold_against_limit(predicted["error_95_max_m"], rule)
        listing = {
            "poses": [self._listed(k, visit) for k, visit in enumerate(visits)],
            "locate": [self._listed(k, visit) for k, visit in enumerate(locate)],
            "predicted": {**predicted, "random_rms_m": random_rms},
            "rank": observed.rank,
            "rank_possible": observed.rank_possible,
            "unidentifiable": list(observed.unidentifiable),
            "source_rule": rule_entry(rule),
            "by_rule": by_rule,
            "stored": len(self._request.stored),
            "not_possible": space.why_not(),
            "lost": lost,
            "T_base_tracker": self._request.T_base_tracker,
        }
        return SamplingPlan(visits, locate, listing, self._hub.tolist())

    # -- which poses

    def _chosen(self, validation: Array) -> tuple[_Poses, float | None]:
        """All poses that are still to be measured, and the error (m) that as many random ones would leave."""
        space, wanted = self._space, self._count + self._held
        joints = space.spec.arm.joints
        if not wanted:
            return _Poses(np.zeros((0, joints)), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)), None
        enough = max(_CANDIDATES * wanted, _LEAST_CANDIDATES)
        Q, target = self._candidates = space.candidates(enough, self._rng, self._hub)
        if len(Q) < wanted:
            raise error(
                "TRACKER_PLAN_REFUSED",
                f"only {len(Q)} of {space.refused['tried']} poses that were tried are possible, {wanted} are "
                f"wanted ({space.why_not()})",
            )
        aside = self._rng.permutation(len(Q))[: self._held]
        rest = np.setdiff1d(np.arange(len(Q)), aside)
        chosen, own, random_rms = Q[:0], target[:0], None
        if self._count:
            chosen, own, random_rms = self._best(Q[rest], target[rest], validation)
        held = np.concatenate([np.zeros(len(chosen), dtype=bool), np.ones(len(aside), dtype=bool)])
        return _Poses(
            np.concatenate([chosen, Q[aside]]), np.concatenate([own, target[aside]]), held
        ), random_rms

    def _best(self, Q: Array, target: Targets, validation: Array) -> tuple[Array, Targets, float]:
        """The poses to solve from. Those close to candidates that cannot be got to give way to candidates."""
        space, model = self._space, self._space.model
        plan = choose_poses(
            model,
            model.nominal,
            Q,
            target,
            space.promise,
            validation,
            self._count,
            measured=self._with_done(Q[:0], target[:0]),
        )
        free = np.array([blocked(self._hub, q, space.check_path) is None for q in plan.q])
        kept = plan.q[free], plan.target[free]
        before = self._with_done(*kept)
        design = make_design(
            model, model.nominal, Q, target, space.sigma(Q, target), validation, measured=before
        )
        more = choose(design, int(np.sum(~free)))
        return np.concatenate([kept[0], Q[more]]), np.concatenate([kept[1], target[more]]), plan.random_rms

    def _with_done(self, Q: Array, target: Targets) -> tuple[Array, Targets, Array] | None:
        """These poses and the finished ones with what the tracker promises there; None of nothing."""
        Q, target = np.concatenate([self._done_q, Q]), np.concatenate([self._done_target, target])
        return (Q, target, self._space.sigma(Q, target)) if len(Q) else None

    def _ordered(
        self, start: Array, poses: _Poses, by_rule: bool
    ) -> tuple[list[tuple[int, bool]], list[dict[str, Any]]]:
        """Rows in their order with whether they go by the hub, and what cannot be got to.

        A reflector that a person carries is carried once from nest to nest.
        """
        last = self._done_q[-1] if len(self._done_q) else None
        least = RULE_ANGLE / np.maximum(self._gear, 1e-12)
        Q, target = poses.q, poses.target
        each = range(len(self._config.reflectors)) if self._config.swap_by_operator else [None]
        order: list[tuple[int, bool]] = []
        lost = []
        for k in each:
            mine = np.arange(len(Q)) if k is None else np.flatnonzero(target == k)
            far = FarSteps(last, least, ~poses.held_out[mine]) if by_rule else None
            found = tour(start, Q[mine], self._space.check_path, self._hub, far)
            order += [(int(mine[row]), by_hub) for row, by_hub in zip(found.rows, found.via, strict=True)]
            lost += [{"q": Q[mine[row]].tolist(), "why": why} for row, why in found.lost.items()]
            if order:
                start = Q[order[-1][0]]
            last = next((Q[row] for row, _ in reversed(order) if not poses.held_out[row]), last)
        return order, lost

    def _with_far_steps(self, start: Array, poses: _Poses, validation: Array) -> _Poses:
        """``poses`` with other candidates for those that no order has far from the ones before and after."""
        for _ in range(_EXCHANGES):
            order, _ = self._ordered(start, poses, by_rule=True)
            rows = [row for row, _ in order if not poses.held_out[row]]
            before = self._done_q[-1:]
            short = short_steps(np.concatenate([before, poses.q[rows]]) * self._gear).any(axis=1)
            ends = np.flatnonzero(short) + 1 - len(before)
            either = [int(k) for k in (*ends, *(ends - 1)) if k >= 0]
            tried = (self._exchanged(poses, rows, k, validation) for k in either)
            if (other := next((found for found in tried if found is not poses), None)) is None:
                break
            poses = other
        return poses

    def _exchanged(self, poses: _Poses, rows: list[int], k: int, validation: Array) -> _Poses:
        """``poses`` with the best candidate for ``rows[k]`` that is far from its neighbours, if there is."""
        space, row = self._space, rows[k]
        others = [other for other in rows if other != row]
        beside = np.concatenate(
            [poses.q[rows[k - 1 : k]] if k else self._done_q[-1:], poses.q[rows[k + 1 : k + 2]]]
        )
        Q, target = self._candidates
        fits = np.all(np.abs(Q[:, None] - beside) * self._gear > RULE_ANGLE, axis=(1, 2))
        fits &= ~np.any(np.all(Q[:, None] == poses.q, axis=2), axis=1)
        if self._config.swap_by_operator:
            fits &= target == poses.target[row]
        if not fits.any():
            return poses
        model, Q, target = space.model, Q[fits], target[fits]
        measured = self._with_done(poses.q[others], poses.target[others])
        design = make_design(
            model, model.nominal, Q, target, space.sigma(Q, target), validation, measured=measured
        )
        (best,) = choose(design, 1)
        q, own = poses.q.copy(), poses.target.copy()
        q[row], own[row] = Q[best], target[best]
        return _Poses(q, own, poses.held_out)

    def _path(self, start: Array, Q: Array, order: list[tuple[int, bool]]) -> Array:
        path = [start]
        for row, by_hub in order:
            path += [self._hub, Q[row]] if by_hub else [Q[row]]
        return np.array(path)

    @property
    def _hub(self) -> Array:
        """Where ways meet that are not free directly."""
        poses = self._request.values.poses
        home = poses.get("home") if self._config.arm == "arm" else None
        return self._start if home is None else np.array(home, dtype=float)

    def _visit(self, q: Array, target: int, held: bool, by_hub: bool) -> Visit:
        name = list(self._config.reflectors)[int(target)]
        via = [self._hub.tolist()] if by_hub else []
        return Visit([float(v) for v in q], name, bool(held), via)

    # -- finding the tracker

    def _locate(self) -> list[Visit]:
        """Poses far apart: candidates where the tracker's place is assumed, else close to the arm's own."""
        if self._request.measured:
            return []
        Q = self._near_start() if self._space.view is None else self._candidates[0][self._candidates[1] == 0]
        first = np.zeros(len(Q), dtype=np.int64)
        far = _far_apart(self._space.points(Q, first), self._config.locate_poses)
        if len(far) < self._config.locate_poses:
            raise error(
                "TRACKER_PLAN_REFUSED",
                f"only {len(far)} of locate_poses = {self._config.locate_poses} poses are possible",
            )
        found = tour(self._start, Q[far], self._space.check_path, self._hub)
        if found.lost:
            raise error("TRACKER_PLAN_REFUSED", f"a pose to locate with: {next(iter(found.lost.values()))}")
        return [
            self._visit(Q[far[row]], 0, False, by_hub)
            for row, by_hub in zip(found.rows, found.via, strict=True)
        ]

    def _near_start(self) -> Array:
        """(n, j): joints about the start pose whose flange faces the same way, so the tracker sees it."""
        space, start = self._space, self._start
        gear = np.maximum(np.max(np.abs(space.spec.arm.base.coupling), axis=0), 1e-12)
        Q = start + self._rng.uniform(-_NEAR_RAD, _NEAR_RAD, (20 * _NEAR_DRAWS, len(start))) / gear
        facing, first = space.flange(Q)[:, :3, :3], space.flange(start[None])[0, :3, :3]
        cosine = 0.5 * (np.einsum("nij,ij->n", facing, first) - 1.0)
        if space.guard is not None:  # a palletizer yaws with its base; its reflector has to look all round
            Q = Q[np.arccos(np.clip(cosine, -1.0, 1.0)) < _SAME_FACING_RAD]
        possible = np.isfinite(space.promise(Q, np.zeros(len(Q), dtype=np.int64)))
        near: Array = Q[possible][:_NEAR_DRAWS]
        return near

    # -- what the poses promise

    def _observed(self, Q: Array, target: Targets) -> Observability:
        """Rank and open combinations; ``TRACKER_PLAN_UNOBSERVABLE`` where other poses would show more."""
        space, model = self._space, self._space.model
        problem = Problem(model, Q, np.zeros((3, len(Q))), target)
        _, J = model.linearised(model.nominal, Q, target)
        found = observe(problem, J, np.ones(len(Q)), model.nominal)
        refusal = refuse(problem, found, space.spec.robot.prior is not None)
        if refusal is not None:
            raise error("TRACKER_PLAN_UNOBSERVABLE", str(refusal))
        return found

    def _predicted(self, Q: Array, target: Targets, validation: Array) -> dict[str, Any]:
        """Errors (m) of predictions all over the space, after readings at these poses."""
        space, model = self._space, self._space.model
        design = make_design(model, model.nominal, Q, target, space.sigma(Q, target), validation)
        rows = range(len(Q))
        _, J = model.linearised(model.nominal, validation, np.zeros(len(validation), dtype=np.int64))
        cov = np.asarray(np.linalg.inv(design.information(rows)), dtype=float)
        cov = self._with_constant(cov, Q, target)
        error95 = lengths95(base_covariance(cov, J))
        return {
            "rms_m": design.predicted_rms(rows),
            "error_95_median_m": float(np.median(error95)),
            "error_95_max_m": float(error95.max()),
            "assuming": {**self._request.noise, KEY: self._config.constant_sigma_m},
        }

    def _with_constant(self, cov: Array, Q: Array, target: Targets) -> Array:
        """``cov`` with what stays open of the reflector's constant; as it is while no beam is known."""
        space, sigma = self._space, self._config.constant_sigma_m
        if space.view is None or not sigma > 0.0:
            return cov
        f, J = space.model.linearised(space.model.nominal, Q, target)
        beams = f - space.view.place.translation[:, None]
        beams /= np.linalg.norm(beams, axis=0)
        return cov + open_constant(cov, J, beams, 1.0 / space.sigma(Q, target), sigma)

    def _hold_against_limit(self, error95_m: float, rule: SourceRule) -> None:
        """Beyond the limit a plan may still go on by the rule of thumb for poses."""
        limit = self._config.max_predicted_m
        if error95_m <= limit * _AHEAD or rule.kept:
            return
        raise error(
            "TRACKER_PLAN_REFUSED",
            f"max_predicted_m: at worst 95 % of the errors stay below {1e3 * error95_m:.3f} mm, the "
            f"limit is {1e3 * limit:g} mm; nor is the rule of thumb for poses kept ({rule_text(rule)})",
        )

    def _listed(self, number: int, visit: Visit) -> dict[str, Any]:
        space = self._space
        Q = np.array([visit.q])
        target = np.array([list(self._config.reflectors).index(visit.reflector)])
        p = space.points(Q, target)
        entry: dict[str, Any] = {
            "index": number,
            "q": visit.q,
            "reflector": visit.reflector,
            "held_out": visit.held_out,
            "via": visit.via,
            "p_base": p[0].tolist(),
        }
        if space.view is not None:
            entry["range_m"] = float(np.linalg.norm(p[0] - space.view.place.translation))
        if space.guard is not None:
            entry["checks"] = space.guard.describe(Q[0]).as_dict()
        return entry


def _far_apart(p: Array, count: int) -> list[int]:
    """Rows of ``p`` (n, 3) that are far from each other, taken one by one; few when they lie on a line."""
    if not len(p):
        return []
    rows = [int(np.argmax(np.linalg.norm(p - p.mean(axis=0), axis=1)))]
    while len(rows) < min(count, len(p)):
        away = np.min(np.linalg.norm(p[:, None] - p[rows][None], axis=2), axis=1)
        rows.append(int(np.argmax(away)))
    return rows


def measured_entries(samples: Sequence[Mapping[str, Any]]) -> list[tuple[list[float], str, bool]]:
    """Finished poses as :class:`PlanRequest` wants them."""
    return [([float(v) for v in s["q"]], str(s["target"]), bool(s["held_out"])) for s in samples]
