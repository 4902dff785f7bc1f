"""What of an observed arm hides its reflector: drawn from its table, and left out by a plan."""

from typing import Any

import numpy as np

from calibration.kinematics import UrArmModel
from calibration.kinematics.families import arm_spec
from cell.formats.robot import parse_robot
from cell.poses import Array
from cell.run_values import RunValues
from fakes.world.palletizer.linkage import Palletizer
from fakes.world.scenario import Scenario
from fakes.world.tracker.visibility import BROKEN
from fakes.world.world import World
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import make_space
from procedures.tracker.occlusion import Shape, shape_of

RADIUS_M = 0.1
NOISE = {"sigma0": 15e-6, "sigma_per_m": 6e-6}


def palletizer() -> dict[str, Any]:
    observed = Scenario.load("palletizer:ideal").world.observed
    assert observed is not None
    return {"family": "palletizer4", "parameters": observed.parameters.model_dump()}


def shape(robot: dict[str, Any], radius_m: float | None) -> Shape | None:
    return shape_of(arm_spec(parse_robot(robot, "robot")), None, radius_m)


def joints(count: int) -> Array:
    return np.random.default_rng(2).uniform((-3.1, 0.8, -2.2, -3.0), (3.1, 2.1, -0.6, 3.0), (count, 4))


def test_a_palletizers_links_are_where_the_twin_has_them() -> None:
    drawn, twin = shape(palletizer(), RADIUS_M), Palletizer.from_mapping(palletizer()["parameters"])
    assert drawn is not None
    Q = joints(20)
    for q, mine in zip(Q, drawn.ends(Q), strict=True):
        for line in twin.lines(q):
            off = [np.linalg.norm(np.sort(ends, axis=0) - np.sort(line, axis=0)) for ends in mine]
            assert min(off) < 1e-9, "each of the twin's links is one of the drawn ones"
        lowest = [np.linalg.norm(ends[1] - twin.flange(q).translation) for ends in mine]
        assert min(lowest) < 1e-9, "one of them ends at the flange"
    assert np.all(drawn.radii == RADIUS_M)


def test_lengths_say_nothing_without_a_radius_and_a_ur_needs_none() -> None:
    assert shape(palletizer(), None) is None
    ur, maker = shape({"model": "ur10e"}, None), UrArmModel("ur10e")
    assert ur is not None
    Q = np.random.default_rng(3).uniform(-3.0, 3.0, (5, 6))
    assert np.array_equal(ur.ends(Q), maker.link_ends(Q))
    assert ur.radii.tolist() == [link.radius_m for link in maker.links]


def test_a_pose_is_not_offered_where_the_arm_stands_between_its_reflector_and_the_tracker() -> None:
    # The arm reaches away from a tracker in front of it; its post is in between.
    section = {
        "arm": "observed_arm",
        "payload_kg": 1.0,
        "joint_ranges_rad": [[-3.2, 3.2], [0.8, 2.1], [-2.2, -0.6], [-3.0, 3.0]],
        "reflectors": {"smr1": {"point": [0.12, 0.0, -0.06]}},
    }
    away, beside = [np.pi, np.pi / 2, -2.1, 0.0], [0.6, np.pi / 2, -2.1, 0.0]
    seen = {}
    for radius in (None, RADIUS_M):
        config = TrackerSamplingConfig.model_validate({**section, "sight": {"link_radius_m": radius}})
        values = RunValues({"model": "ur10e"}, observed_robot=palletizer())
        space = make_space(values, config, NOISE, [4.0, 0.0, 0.6, 0.0, 0.0, np.pi])
        seen[radius] = np.isfinite(space.promise(np.array([away, beside]), np.zeros(2, dtype=np.int64)))
    assert seen[None].tolist() == [True, True]
    assert seen[RADIUS_M].tolist() == [False, True]


def test_no_pose_that_is_offered_is_hidden_in_the_twin() -> None:
    scenario = Scenario.load("palletizer:ideal")
    world = World.from_scenario(scenario)
    assert world.observed is not None
    assert world.tracker is not None
    config = {**scenario.cell.job["tracker-sampling"], "joint_ranges_rad": [[-3.2, 3.2]] * 4}
    Q, target = joints(400), np.zeros(400, dtype=np.int64)
    broken = np.zeros(len(Q), dtype=bool)
    for k, q in enumerate(Q):
        world.observed.track.hold(float(k), q)
        broken[k] = world.tracker.visibility.hindrance("smr1", float(k)) == BROKEN
    T = scenario.world.tracker.T_base_tracker  # type: ignore[union-attr]
    offered = {}
    for radius in (None, RADIUS_M):
        job = TrackerSamplingConfig.model_validate({**config, "sight": {"link_radius_m": radius}})
        space = make_space(RunValues({"model": "ur10e"}, observed_robot=palletizer()), job, NOISE, T)
        offered[radius] = np.isfinite(space.promise(Q, target))
    assert np.any(broken & offered[None]), "the twin's links do hide some of them"
    assert not np.any(broken & offered[RADIUS_M])
    assert np.sum(offered[RADIUS_M]) > 0.5 * np.sum(~broken)
