"""What a plan promises: poses that are free, seen and got to; refused where they would tell too little."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from calibration.identification.estimator import Problem
from calibration.identification.solution import identify
from calibration.kinematics import robot_from_spec
from cell.errors import CellError, error
from cell.guard import PLANNED_CLEAR_M, GuardLimits, MotionGuard, Tool
from cell.poses import Array, from_pose6
from cell.run_values import RunValues
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.tracker import plan as planning
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import Space, make_space
from procedures.tracker.line_of_sight import REASONS
from procedures.tracker.plan import PlanRequest, SamplingPlan, plan_sampling
from procedures.tracker.plan_words import tracker_plan_lines
from procedures.tracker.visit_order import FarSteps, Tour, blocked, shortest, tour
from tests.kit.tracker_cell import BRISK, nominal_tracker, reflectors, rms

NOISE = {"sigma0": 15e-6, "sigma_per_m": 6e-6}
HOME = [0.6, -1.8, 1.8, -0.1, 1.57, 0.0]
PILLAR = {"name": "pillar", "min": [-1.2, -0.9, 0.0], "max": [-0.9, -0.6, 1.5]}


def values(**limits: Any) -> RunValues:
    return RunValues(
        robot={"model": "ur10e"},
        tool={"name": "holder", "T_flange_tool": [0.0, 0.0, 0.08, 0.0, 0.0, 0.0], "radius_m": 0.06},
        payload_kg=0.8,
        limits={**BRISK, "keep_out": [], **limits},
        poses={"home": HOME},
    )


def request(cell: RunValues | None = None, located: bool = True, **job: Any) -> PlanRequest:
    section = {"reflectors": reflectors("tracker", "smr1"), "poses": 12, "max_predicted_m": 0.01, **job}
    config = TrackerSamplingConfig.model_validate(section)
    T = nominal_tracker("tracker") if located else None
    return PlanRequest(cell or values(), config.model_dump(), NOISE, T, HOME)


def space_of(asked: PlanRequest) -> Space:
    config = TrackerSamplingConfig.model_validate(asked.config)
    return make_space(asked.values, config, asked.noise, asked.T_base_tracker)


def joints(plan: SamplingPlan) -> Array:
    return np.array([visit.q for visit in plan.visits])


@pytest.fixture(scope="module")
def usual() -> SamplingPlan:
    """The plan of the plain request, which several tests look at."""
    return plan_sampling(request())


# -- poses


def test_every_pose_is_free_and_seen_and_every_way_between_them_is_free() -> None:
    asked = request(values(keep_out=[PILLAR]))
    space, plan = space_of(asked), plan_sampling(asked)
    assert len(plan.visits) == 12
    assert sum(visit.held_out for visit in plan.visits) == 2
    target = np.zeros(12, dtype=np.int64)
    assert np.all(np.isfinite(space.promise(joints(plan), target)))
    here = np.array(HOME)
    for visit in (*plan.locate, *plan.visits):
        for q in (*visit.via, visit.q):
            space.check_path(here, np.array(q))
            here = np.array(q)


def test_an_arm_stopped_anywhere_on_a_way_can_be_planned_for_again() -> None:
    space = space_of(request())
    assert space.guard is not None
    rng = np.random.default_rng(5)
    Q, _ = space.candidates(16, rng, np.array(HOME))
    ways = [(a, b) for a, b in combinations(Q, 2) if blocked(a, b, space.check_path) is None]
    assert len(ways) > 40
    share = np.linspace(0.0, 1.0, 1500)[:, None]
    kept = 0.5 * PLANNED_CLEAR_M
    assert all(np.all(space.guard.free(a + share * (b - a), kept)) for a, b in ways)


def test_an_arm_that_stands_in_its_own_way_is_refused_in_words() -> None:
    asked = replace(request(), q_start=[0.6, -1.8, 2.9, -0.1, 1.57, 0.0])
    with pytest.raises(CellError) as caught:
        plan_sampling(asked)
    assert caught.value.name == "TRACKER_PLAN_REFUSED"
    assert "the arm stands where it may not be, move it by hand" in caught.value.detail


def test_the_reflector_looks_at_the_tracker_at_every_pose(usual: SamplingPlan) -> None:
    asked = request()
    place = from_pose6(asked.T_base_tracker)
    arm = robot_from_spec({"model": "ur10e"})
    truth = Scenario.load("tracker:ideal").world.reflectors["smr1"]
    for visit in usual.visits:
        T = arm.forward(np.array(visit.q))
        beam = place.translation - T.apply(truth.point)
        cosine = T.rotation.apply(truth.normal) @ beam / np.linalg.norm(beam)
        assert np.arccos(cosine) <= 0.9


def test_a_beam_that_a_link_or_a_box_would_break_is_not_planned() -> None:
    asked = request(values(keep_out=[PILLAR]))
    space = space_of(asked)
    assert space.view is not None
    eye = space.view.place.translation
    box = np.array([PILLAR["min"], PILLAR["max"]])
    behind = box.mean(axis=0) + 0.4 * (box.mean(axis=0) - eye) / np.linalg.norm(box.mean(axis=0) - eye)
    beside = behind + np.array([-0.6, 0.8, 0.0])
    assert space.view.hidden(np.array([behind, beside]), None).tolist() == [True, False]
    link = np.array(
        [[behind + 0.5 * (eye - behind) + [0, 0, 0.4], behind + 0.5 * (eye - behind) - [0, 0, 0.4]]]
    )
    bare = replace(space.view, boxes=(), radii=np.array([0.05]))
    assert bare.hidden(behind[None], link[None]).tolist() == [True]
    assert bare.hidden(behind[None], link[None] + 0.5).tolist() == [False]


def test_range_elevation_and_cone_are_told_apart() -> None:
    space = space_of(request(reflectors={"smr1": {"point": [0, 0, 0], "normal": [0, 0, 1]}}))
    assert space.view is not None
    place = space.view.place
    facing = np.eye(4)
    at = place.apply([[0.3, 0.0, 0.0], [0.1, 0.0, 4.0], [3.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    T = np.repeat(facing[None], 4, axis=0)
    beam = (place.translation - at[3]) / np.linalg.norm(place.translation - at[3])
    T[3, :3, 2] = beam
    T[2, :3, 2] = -beam
    found = space.view.faults(T, at, np.zeros(4, dtype=np.int64))
    assert [None if k < 0 else REASONS[k] for k in found] == [*REASONS[:3], None]


def test_many_poses_are_judged_as_the_guard_judges_each() -> None:
    limits = GuardLimits.from_mapping({**BRISK, "keep_out": [PILLAR]})
    guard = MotionGuard(robot_from_spec({"model": "ur10e"}), limits, Tool.from_mapping(values().tool))
    Q = np.random.default_rng(1).uniform(-np.pi, np.pi, (300, 6))
    Q[:5, 0] = 7.0

    def passes(q: Array) -> bool:
        try:
            guard.check_joints(q)
        except CellError:
            return False
        return True

    free = guard.free(Q)
    assert free.tolist() == [passes(q) for q in Q]
    assert 20 < free.sum() < 280


def test_the_tracker_is_located_from_poses_far_apart(usual: SamplingPlan) -> None:
    p = space_of(request()).points(np.array([v.q for v in usual.locate]), np.zeros(4, dtype=np.int64))
    assert np.linalg.svd(p - p.mean(axis=0), compute_uv=False)[1] > 0.2


def test_where_nobody_knows_the_trackers_place_it_is_located_close_to_the_start() -> None:
    plan = plan_sampling(request(located=False))
    Q = np.array([v.q for v in plan.locate])
    assert np.max(np.abs(Q - HOME)) < 0.4
    assert "range_m" not in plan.listing["poses"][0]


def test_finished_poses_are_counted_and_planned_around(usual: SamplingPlan) -> None:
    asked = request()
    done = [(v.q, v.reflector, v.held_out) for v in usual.visits[:7]]
    again = plan_sampling(replace(asked, measured=done))
    assert len(again.visits) == 5
    assert again.locate == []
    assert sum(held for *_, held in done) + sum(v.held_out for v in again.visits) == 2
    everything = [(v.q, v.reflector, v.held_out) for v in usual.visits]
    assert plan_sampling(replace(asked, measured=everything)).visits == []


def test_a_carried_reflector_is_carried_once_from_nest_to_nest() -> None:
    both = reflectors("tracker", "smr1", "smr2")
    plan = plan_sampling(request(reflectors=both, poses=15, swap_by_operator=True))
    names = [visit.reflector for visit in plan.visits]
    assert names == sorted(names)
    assert set(names) == {"smr1", "smr2"}


def test_the_same_request_gives_the_same_plan(usual: SamplingPlan) -> None:
    assert plan_sampling(request()) == usual


# -- refused before anything moves


def test_a_plan_that_cannot_determine_the_arm_is_refused_by_name(usual: SamplingPlan) -> None:
    assert usual.listing["rank"] == usual.listing["rank_possible"] == 21
    ranges = [[-2, 2], [-2.2, -0.8], [1.0, 1.0], [-2, 2], [-2, 2], [-2, 2]]
    with pytest.raises(CellError, match="joint-still: joint 3 does not move") as caught:
        plan_sampling(request(joint_ranges_rad=ranges))
    assert caught.value.name == "TRACKER_PLAN_UNOBSERVABLE"


def test_too_few_poses_for_the_unknowns_are_refused_by_name() -> None:
    with pytest.raises(CellError, match="too-few-poses: 6 samples") as caught:
        plan_sampling(request(poses=7))
    assert caught.value.name == "TRACKER_PLAN_UNOBSERVABLE"


def test_a_predicted_error_beyond_the_limit_is_refused_unless_the_sources_rule_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(CellError, match=r"is 0\.01 mm; nor is the rule of thumb for poses kept") as caught:
        plan_sampling(request(max_predicted_m=0.00001))
    assert caught.value.name == "TRACKER_PLAN_REFUSED"
    monkeypatch.setattr("calibration.identification.selection.RULE_POSES", 10)
    monkeypatch.setattr("calibration.identification.selection.RULE_ANGLE", -1.0)
    assert plan_sampling(request(max_predicted_m=0.00001)).listing["source_rule"]["kept"]


def test_a_plan_that_is_to_keep_the_rule_keeps_it_and_says_what_that_costs() -> None:
    asked = request(poses=63, keep_rule=True)
    free, plan = plan_sampling(request(poses=63)).listing, plan_sampling(asked)
    assert (free["source_rule"]["samples"], free["source_rule"]["kept"], free["by_rule"]) == (50, False, None)
    assert plan.listing["source_rule"]["kept"]
    steps = np.abs(np.diff([visit.q for visit in plan.visits if not visit.held_out], axis=0))
    assert len(steps) == 49
    assert np.degrees(steps.min()) > 15.0
    assert plan.listing["predicted"]["rms_m"] == pytest.approx(free["predicted"]["rms_m"], rel=1e-6)
    space, here = space_of(asked), np.array(HOME)
    for visit in (*plan.locate, *plan.visits):
        for q in (*visit.via, visit.q):
            space.check_path(here, np.array(q))
            here = np.array(q)
    cost = plan.listing["by_rule"]
    assert 1.0 < cost["travel_rad"] / cost["shortest_rad"] < 2.0
    assert 1.0 < cost["moving_s"] / cost["shortest_s"] < 2.0
    costs = cost["moving_s"] - cost["shortest_s"]
    assert f"is kept by their order, which costs {costs:.0f} s of" in "\n".join(
        tracker_plan_lines(plan.listing)
    )


def test_a_run_that_is_taken_up_keeps_the_rule_from_its_last_pose_on() -> None:
    first = plan_sampling(request(poses=63, keep_rule=True)).visits[:30]
    measured = [(visit.q, visit.reflector, visit.held_out) for visit in first]
    plan = plan_sampling(replace(request(poses=63, keep_rule=True), measured=measured))
    Q = np.array([visit.q for visit in (*first, *plan.visits) if not visit.held_out])
    assert len(Q) == 50
    assert np.degrees(np.abs(np.diff(Q, axis=0)).min()) > 15.0


def test_a_run_whose_poses_were_measured_in_another_order_is_taken_up_and_does_not_claim_the_rule() -> None:
    asked = request(poses=63, keep_rule=True)
    first = plan_sampling(asked).visits[:30]
    here = np.array(HOME)
    measured = [first[row] for row in shortest(here, np.array([visit.q for visit in first]))]
    done = np.array([visit.q for visit in measured if not visit.held_out])
    assert np.degrees(np.abs(np.diff(done, axis=0)).min()) < 15.0
    plan = plan_sampling(
        replace(asked, measured=[(visit.q, visit.reflector, visit.held_out) for visit in measured])
    )
    assert not plan.listing["source_rule"]["kept"]
    to_come = np.array([done[-1], *(visit.q for visit in plan.visits if not visit.held_out)])
    assert len(done) + len(to_come) - 1 == 50
    assert np.degrees(np.abs(np.diff(to_come, axis=0)).min()) > 15.0


def test_poses_that_are_lost_break_the_rule_by_their_number_and_no_joint_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def losing(*asked: Any) -> Tour:
        found, far = tour(*asked), asked[-1]
        if not isinstance(far, FarSteps):
            return found
        first = next(k for k, row in enumerate(found.rows) if far.counted[row])
        rows, via = list(found.rows), list(found.via)
        del via[first]
        return Tour(rows, via, {rows.pop(first): "the pillar is in the way"})

    monkeypatch.setattr("procedures.tracker.plan.tour", losing)
    with pytest.raises(
        CellError, match=r"49 of 50 poses .* left; 1 have no .*: the pillar is in the way. Raise poses"
    ) as caught:
        plan_sampling(request(poses=63, keep_rule=True))
    assert caught.value.name == "TRACKER_PLAN_REFUSED"
    assert "joint" not in caught.value.detail


def test_the_first_step_is_free_where_no_pose_was_measured_before() -> None:
    start, Q = np.array([0.0]), np.array([[0.1], [1.0], [0.5]])
    least, counted = np.array([0.3]), np.ones(3, dtype=bool)
    assert FarSteps(None, least, counted).order(start, Q) == [0, 2, 1]
    assert FarSteps(start, least, counted).order(start, Q)[0] != 0


def test_the_earlier_pose_of_a_short_step_gives_way_where_the_later_one_cannot() -> None:
    here = np.array(HOME)
    only, first, later = here - 0.2, here, here + 0.1
    asked = request(poses=63, keep_rule=True)
    config = TrackerSamplingConfig.model_validate(asked.config)
    subject = planning._Planner(asked, config, space_of(asked))
    subject._candidates = only[None], np.zeros(1, dtype=np.int64)
    chosen = planning._Poses(np.array([first, later]), np.zeros(2, dtype=np.int64), np.zeros(2, dtype=bool))
    validation = here + np.linspace(-0.5, 0.5, 5)[:, None]
    found = subject._with_far_steps(here, chosen, validation)
    assert found.q.tolist() == [only.tolist(), later.tolist()]


def test_a_rule_that_a_joint_cannot_keep_is_refused_with_the_joint() -> None:
    ranges = [[-2, 2], [-2.2, -0.8], [1.0, 1.2], [-2, 2], [-2, 2], [-2, 2]]
    with pytest.raises(
        CellError, match=r"keep_rule: 50 of 50 poses, .* joint 3, whose range is 11 deg"
    ) as caught:
        plan_sampling(request(poses=63, keep_rule=True, joint_ranges_rad=ranges))
    assert caught.value.name == "TRACKER_PLAN_REFUSED"


def test_too_few_poses_for_the_rule_are_refused_with_how_many_it_takes() -> None:
    with pytest.raises(ValueError, match="poses = 40 leaves 32; make poses 62"):
        request(poses=40, keep_rule=True)


def test_a_place_from_which_nothing_is_seen_is_refused_with_what_is_in_the_way() -> None:
    asked = replace(request(), T_base_tracker=[50.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    with pytest.raises(CellError, match=r"only 0 of .* \(100\.0 % too near or too far") as caught:
        plan_sampling(asked)
    assert caught.value.name == "TRACKER_PLAN_REFUSED"


def test_joint_ranges_of_another_arm_are_refused() -> None:
    with pytest.raises(CellError, match="has 4 entries; the arm has 6 joints"):
        plan_sampling(request(joint_ranges_rad=[[-1, 1]] * 4))


# -- thirty chosen poses against thirty random ones


def measured(world: World, Q: Array, rng: np.random.Generator) -> Array:
    """(3, n): what the twin's tracker reads of smr1 at these joints, by the twin's own kinematics."""
    assert world.tracker is not None
    stand, point = world.tracker.stand.at(world.t0), world.config.reflectors["smr1"].point
    p = np.array([stand.inv().apply(world.true.forward(q).apply(point)) for q in Q])
    sigma = NOISE["sigma0"] + NOISE["sigma_per_m"] * np.linalg.norm(p, axis=1)
    noisy: Array = (p + sigma[:, None] * rng.normal(size=p.shape)).T.copy()
    return noisy


def test_thirty_chosen_poses_predict_as_promised_and_better_than_random_ones_in_the_twin() -> None:
    asked = request(poses=30, held_out_share=0.0)
    plan, space = plan_sampling(asked), space_of(asked)
    promised = plan.listing["predicted"]
    assert promised["rms_m"] <= 0.80 * promised["random_rms_m"]
    world = World.from_scenario(Scenario.load("tracker:ideal"))
    rng = np.random.default_rng(3)
    candidates, _ = space.candidates(240, rng, np.array(HOME))
    validation = space.anywhere(60, rng)
    true = measured(world, validation, np.random.default_rng(0)) * 0.0
    for k, q in enumerate(validation):
        flange = world.true.forward(q)
        true[:, k] = (
            world.tracker.stand.at(world.t0)
            .inv()
            .apply(  # type: ignore[union-attr]
                flange.apply(world.config.reflectors["smr1"].point)
            )
        )

    def off(Q: Array, seed: int) -> float:
        noisy = measured(world, Q, np.random.default_rng(seed))
        solved = identify(Problem(space.model, Q, noisy, np.zeros(len(Q), dtype=np.int64)), NOISE)
        return rms(np.linalg.norm(solved.predict(validation)[0].T - true, axis=0))

    chosen = rms([off(joints(plan), seed) for seed in range(24)])
    random = rms([off(candidates[rng.permutation(240)[:30]], 100 + seed) for seed in range(24)])
    assert chosen <= 0.80 * random
    assert chosen == pytest.approx(promised["rms_m"], rel=0.3)


# -- the order of the visits


def test_an_order_is_no_longer_than_going_to_the_nearest_each_time() -> None:
    Q = np.random.default_rng(2).uniform(-2, 2, (25, 6))
    start = np.zeros(6)

    def length(order: list[int]) -> float:
        path = np.vstack([start, Q[order]])
        return float(np.max(np.abs(np.diff(path, axis=0)), axis=1).sum())

    nearest, here, free = [], start, set(range(25))
    while free:
        k = min(free, key=lambda k: (float(np.max(np.abs(Q[k] - here))), k))
        nearest.append(k)
        free.remove(k)
        here = Q[k]
    order = shortest(start, Q)
    assert sorted(order) == list(range(25))
    assert length(order) <= length(nearest) + 1e-9


def test_a_pose_without_a_direct_way_is_reached_by_the_hub_and_one_without_any_is_lost() -> None:
    Q = np.array([[1.0], [2.0], [3.0]])

    def check(q0: Array, q1: Array) -> None:
        if q1[0] == 3.0:
            raise error("MOTION_COLLISION", "a pillar")
        if {q0[0], q1[0]} == {1.0, 2.0}:
            raise error("MOTION_COLLISION", "a wall")

    found = tour(np.zeros(1), Q, check, np.array([-1.0]))
    assert found.rows == [0, 1]
    assert found.via == [False, True]
    assert found.lost == {2: "a pillar"}


def test_an_arm_that_stands_where_it_may_not_be_has_to_be_moved_by_a_person_first() -> None:
    below = [0.6, -0.3, 0.9, -0.1, 1.57, 0.0]
    with pytest.raises(CellError, match="the arm stands where it may not be, move it by hand") as caught:
        plan_sampling(replace(request(), q_start=below))
    assert caught.value.name == "TRACKER_PLAN_REFUSED"
