"""Items on a belt as they truly are, and what a gripper that closes on them takes."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array
from fakes.frames.belt_view import boxes_seen
from fakes.world.belt.gripper import Gripper
from fakes.world.belt.item_truth import GripperTruth, ItemsTruth
from fakes.world.belt.items import Items
from fakes.world.scenario import Scenario
from fakes.world.world import World

SPEED = 0.2
T_BASE_BELT = RigidTransform.from_components([0.5, -0.3, 0.1], Rotation.from_euler("z", 0.4))
TRUTH = ItemsTruth(spacing_m=0.25, jitter_m=0.05, lateral_m=0.03, yaw_rad=0.5, first_m=0.4)


class Belt:
    T_base_belt = T_BASE_BELT

    def travel_at(self, t: float) -> float:
        return SPEED * t


class Tool:
    """Comes down onto item ``number`` with the given error and slide, in contact from ``t_down`` on."""

    def __init__(
        self, items: Items, number: int, off_m: Array, slide_m_s: float = 0.0, t_down: float = 0.0
    ) -> None:
        self._items, self._number, self._off, self._slide, self._down = (
            items,
            number,
            off_m,
            slide_m_s,
            t_down,
        )

    def __call__(self, t: float) -> Array:
        place = self._items.pose(self._number, t).translation
        height = max(self._down - t, 0.0) * 0.1
        out: Array = place + self._off + [self._slide * (t - 4.0), 0.0, height]
        return out


@pytest.fixture
def items() -> Items:
    return Items(TRUTH, Belt(), seed=7)


def closed_on(items: Items, tool: Tool) -> Gripper:
    gripper = Gripper(GripperTruth(close_s=0.04), items, tool)
    gripper.command(3.96, True)
    return gripper


def test_items_ride_with_the_belt_and_stay_where_they_lie_on_it(items: Items) -> None:
    early, late = items.pose(2, 1.0), items.pose(2, 3.5)
    moved = T_BASE_BELT.rotation.inv().apply(late.translation - early.translation)
    assert moved == pytest.approx([SPEED * 2.5, 0.0, 0.0], abs=1e-12)
    assert (early.rotation.inv() * late.rotation).magnitude() < 1e-12


def test_how_an_item_is_turned_is_worked_out_once(items: Items) -> None:
    """A picture asks for each item in sight, and every picture for the same ones."""
    before = items.pose(2, 1.0)
    items.belt = None  # type: ignore[assignment]
    items.grasp_point = lambda number, t: np.zeros(3)  # type: ignore[method-assign]
    assert items.pose(2, 3.5).rotation.as_quat() == pytest.approx(before.rotation.as_quat(), abs=0.0)


def test_every_item_within_a_stretch_is_listed_and_no_other(items: Items) -> None:
    for t in (0.0, 2.0, 7.7, 30.0):
        along = {n: float(T_BASE_BELT.inv().apply(items.pose(n, t).translation)[0]) for n in range(60)}
        wanted = {n for n, x in along.items() if -0.6 <= x <= 0.9}
        assert set(items.numbers(t, -0.6, 0.9)) == wanted


def test_a_feed_of_three_ends_after_the_third() -> None:
    items = Items(TRUTH.model_copy(update={"count": 3}), Belt(), seed=7)
    assert items.numbers(6.0, -5.0, 1.4) == [0, 1, 2]


def test_heights_are_drawn_between_two_and_change_nothing_else(items: Items) -> None:
    mixed = Items(TRUTH.model_copy(update={"height_m": (0.02, 0.09)}), Belt(), seed=7)
    sizes = np.array([mixed.lying(n).size_m for n in range(100)])
    assert np.all(sizes[:, :2] == TRUTH.size_m[:2])
    assert 0.02 <= sizes[:, 2].min() < 0.025 < 0.085 < sizes[:, 2].max() <= 0.09
    for n in range(3):
        rise = mixed.grasp_point(n, 2.0) - items.grasp_point(n, 2.0)
        assert rise == pytest.approx([0.0, 0.0, sizes[n, 2] - TRUTH.size_m[2]], abs=1e-12)


@pytest.mark.parametrize("height_m", [(0.0, 0.05), (0.05, 0.02), (0.1, 2.0)])
def test_heights_out_of_order_are_refused(height_m: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="height_m"):
        ItemsTruth(height_m=height_m)


def test_a_picture_shows_items_as_high_as_they_are_and_standing_on_the_belt() -> None:
    scenario = Scenario.load("picking:ideal").world
    assert scenario.items is not None
    truth = scenario.items.model_copy(update={"height_m": (0.02, 0.09), "first_m": -0.1})
    world = World(scenario.model_copy(update={"items": truth}), 0.0)
    assert world.items is not None
    assert world.belt is not None
    T_belt_camera = world.belt.T_base_belt.inv() * world.scene(0.0).T_base_camera
    (boxes,) = boxes_seen(world, [0.0])
    assert len({box.size_m for box in boxes}) == len(boxes) >= 3
    for box in boxes:
        assert T_belt_camera.apply(box.T_camera_top.translation)[2] == pytest.approx(box.size_m[2])


def test_fingers_that_close_right_take_the_item_off_the_belt_from_then_on(items: Items) -> None:
    gripper = closed_on(items, Tool(items, 1, np.array([0.001, -0.001, 0.0])))
    assert gripper.holds(3.99) is None
    assert gripper.holds(4.01) == 1
    assert items.numbers(4.1, -0.2, 1.0).count(1) == 0
    assert items.numbers(3.9, -0.2, 1.0).count(1) == 1


@pytest.mark.parametrize(
    ("off_m", "slide_m_s"), [((0.004, 0.0, 0.0), 0.0), ((0.0, 0.0, 0.005), 0.0), ((0.0, 0.0, 0.0), 0.05)]
)
def test_fingers_beside_above_or_sliding_take_nothing(
    items: Items, off_m: tuple[float, float, float], slide_m_s: float
) -> None:
    gripper = closed_on(items, Tool(items, 1, np.array(off_m), slide_m_s))
    assert gripper.holds(4.1) is None
    assert items.taken() == {}


def test_what_is_held_is_let_go_when_the_fingers_have_opened(items: Items) -> None:
    gripper = closed_on(items, Tool(items, 1, np.zeros(3)))
    gripper.command(4.5, False)
    assert gripper.holds(4.52) == 1
    assert gripper.holds(4.55) is None


def test_fingers_that_are_told_to_open_on_their_way_do_not_close(items: Items) -> None:
    gripper = closed_on(items, Tool(items, 1, np.zeros(3)))
    gripper.command(3.99, False)
    assert gripper.holds(4.5) is None
    assert gripper.contacts == []
    assert items.taken() == {}


def test_fingers_that_are_told_to_close_on_their_way_keep_what_they_hold(items: Items) -> None:
    gripper = closed_on(items, Tool(items, 1, np.zeros(3)))
    gripper.command(4.5, False)
    gripper.command(4.52, True)
    assert gripper.holds(5.0) == 1
    assert [contact.item for contact in gripper.contacts] == [1]
    assert gripper.put_down == []
    gripper.command(5.1, False)
    assert gripper.holds(5.2) is None
    assert [down.item for down in gripper.put_down] == [1]


def test_what_is_held_can_be_taken_out_of_fingers_that_stay_closed(items: Items) -> None:
    gripper = closed_on(items, Tool(items, 1, np.zeros(3)))
    assert gripper.empty(3.98) is None
    assert gripper.empty(4.2) == 1
    assert gripper.holds(4.2) is None
    gripper.command(4.5, False)
    assert gripper.holds(4.6) is None
    assert list(items.taken()) == [1]


def test_a_contact_is_judged_where_the_tool_first_came_down(items: Items) -> None:
    gripper = closed_on(items, Tool(items, 1, np.array([0.0003, 0.0004, 0.0]), slide_m_s=0.001, t_down=3.5))
    gripper.settle(4.1)
    (contact,) = gripper.contacts
    assert contact.t_contact == pytest.approx(3.495, abs=0.004)  # 0.5 mm above the face at 0.1 m/s
    assert contact.off_m == pytest.approx((0.0003 - 0.0005, 0.0004), abs=2e-5)
    assert contact.taken


def test_the_same_command_twice_is_one(items: Items) -> None:
    gripper = closed_on(items, Tool(items, 1, np.zeros(3)))
    gripper.command(3.97, True)
    gripper.settle(5.0)
    assert len(gripper.contacts) == 1
