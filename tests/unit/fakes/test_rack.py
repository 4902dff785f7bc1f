"""The twin's rack: what a part meets in a slot, and what fingers take."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from fakes.frames.rack_view import RackView
from fakes.world.rack.contact import SlotShape, Touch, relaxed, touch
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.slot_scene import make_rack

ROOM = 0.0005
SHAPE = SlotShape((0.04, 0.02, 0.1), np.array([ROOM, ROOM]), 0.0, 0.06, 0.2, 30000.0, 20000.0)
CHAMFERED = SlotShape((0.04, 0.02, 0.1), np.array([ROOM, ROOM]), 0.002, 0.06, 0.2, 30000.0, 20000.0)


def felt(
    x: float = 0.0, depth: float = 0.03, tilt: float = 0.0, inward: float = 1.0, shape: SlotShape = SHAPE
) -> Touch:
    """Of a part ``x`` beside the middle, turned by ``tilt`` about the slot's y."""
    turned = Rotation.from_rotvec([0.0, tilt, 0.0])
    return touch(RigidTransform.from_components([x, 0.0, depth], turned).as_matrix(), shape, inward)


def test_a_part_within_the_room_feels_nothing_until_the_end() -> None:
    assert not felt(x=0.9 * ROOM).force.any()
    assert felt(depth=0.0601).force[2] == pytest.approx(-3.0)


def test_a_part_beside_the_opening_meets_the_plate() -> None:
    met = felt(x=1.1 * ROOM, depth=0.0005)
    assert met.on_face
    assert met.force == pytest.approx([0.0, 0.0, -15.0])


def test_before_the_plate_there_is_nothing() -> None:
    assert not felt(x=0.01, depth=-0.001).force.any()


def test_a_chamfer_leads_a_part_in_that_then_rubs() -> None:
    over = 0.001
    riding = felt(x=ROOM + over, depth=0.0005, shape=CHAMFERED)
    rubbing = felt(x=ROOM + over, depth=0.03, shape=CHAMFERED)
    assert not riding.on_face
    # both ends of what is in the slot lie against one wall: twice the side's force, and its friction
    assert rubbing.force == pytest.approx([-2 * 20000.0 * over, 0.0, -0.2 * 2 * 20000.0 * over])
    assert riding.force[2] < rubbing.force[2]


def test_friction_turns_round_with_the_motion() -> None:
    into, out = (felt(x=ROOM + 0.001, shape=CHAMFERED, inward=sign) for sign in (1.0, -1.0))
    assert into.force[2] == pytest.approx(-out.force[2])


@pytest.mark.parametrize(("friction", "wedged"), [(0.6, True), (0.2, False)])
def test_two_contacts_within_the_reach_of_friction_wedge(friction: float, wedged: bool) -> None:
    """Tilted by 0.05 rad it touches at two places 20 mm deep; it wedges when that is less than friction
    times its width of 40 mm."""
    depth = 0.021
    shape = SlotShape(SHAPE.part, SHAPE.room, 0.002, SHAPE.end, friction, 30000.0, 20000.0)
    met = felt(x=0.5 * 0.05 * depth, depth=depth, tilt=0.05, shape=shape)
    assert met.wedged is wedged
    assert bool(met.force[2] < -20.0) is wedged


@pytest.mark.parametrize(
    ("x", "depth", "tilt"), [(0.0, 0.061, 0.0), (0.001, 0.03, 0.0), (-0.001, 0.061, 0.01)]
)
def test_a_part_that_is_let_go_springs_back(x: float, depth: float, tilt: float) -> None:
    """From the end, and from the wall on one side; what it leaned on it touches no more."""
    turned = Rotation.from_rotvec([0.0, tilt, 0.0])
    T = RigidTransform.from_components([x, 0.0, depth], turned).as_matrix()
    assert np.abs(touch(T, CHAMFERED, 0.0).force).max() > 10.0
    rest = relaxed(T, CHAMFERED)
    assert np.abs(touch(rest, CHAMFERED, 0.0).force).max() < 1e-6
    assert np.linalg.norm(rest[:3, 3] - T[:3, 3]) < 0.0015


def test_what_stands_out_of_a_slot_is_met_before_it() -> None:
    shape = SlotShape(SHAPE.part, SHAPE.room, 0.0, -0.04, 0.2, 30000.0, 20000.0)
    assert felt(depth=-0.0399, shape=shape).force == pytest.approx([0.0, 0.0, -3.0])


def test_a_part_goes_with_the_flange_until_it_is_let_go() -> None:
    higher = np.array([0.0, 0.0, 0.1])
    lifted = RigidTransform.from_translation(higher)
    rack = make_rack(lambda t: lifted if 2.0 <= t < 3.5 else RigidTransform.identity())
    at = rack.T_base_part(0, 0.0).translation
    rack.take(0, 1.0)
    assert rack.T_base_part(0, 3.0).translation == pytest.approx(at + higher)
    rack.let_go(0, 3.0)
    assert rack.T_base_part(0, 4.0).translation == pytest.approx(at + higher)
    assert rack.T_base_part(0, 0.5).translation == pytest.approx(at)


def test_a_part_that_is_not_before_the_plate_feels_nothing() -> None:
    rack = make_rack()
    rack.take(0, 1.0)  # at the feed, lower than the plate and far from it
    force, _ = rack.force(2.0)
    assert not force.any()


def test_a_rack_knows_which_slot_a_part_is_in() -> None:
    rack = make_rack()
    assert [rack.in_slot(n, 0.0) for n in range(1, 7)] == [None, 1, None, None, None, None]


def test_a_mirrored_rack_has_every_part_where_it_is() -> None:
    scenario = Scenario.load("slot")
    twin, mirror = World.from_scenario(scenario, 5.0), World.from_scenario(scenario, 5.5)
    assert twin.rack is not None
    assert mirror.rack is not None
    twin.rack.take(0, 6.0)
    twin.mirror_to(mirror.apply)
    twin.track.start_joint_move(6.5, twin.track.at(6.5)[0] + 0.2, 1.0, 2.0)
    twin.rack.let_go(0, 9.0)
    twin.rack.take(1, 10.0)
    for part in (0, 1):
        for t in (5.7, 6.2, 7.0, 9.5, 10.5):
            a, b = (world.rack.T_base_part(part, t).as_matrix() for world in (twin, mirror))  # type: ignore[union-attr]
            assert (a == b).all()
    assert (mirror.rack.in_slot(2, 9.5), mirror.rack.in_slot(2, 10.5)) == (1, None)


def test_two_views_of_one_camera_share_the_noise_that_one_of_them_has_drawn() -> None:
    world = World.from_scenario(Scenario.load("slot"))
    assert world.rack is not None
    first, second = RackView(world, world.rack), RackView(world, world.rack)
    assert first._noise is second._noise
    assert np.std(first._noise) == pytest.approx(world.camera.noise_grey, rel=0.01)
