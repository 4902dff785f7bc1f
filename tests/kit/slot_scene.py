"""A rack as the twin draws it, looked at by a camera on an arm, with the whole truth."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from calibration.slot.marker import SlotMarker
from calibration.slot.opening import Expected
from calibration.slot.rectangle import Rectangle
from calibration.targets import make_target
from cell.devices import Intrinsics
from cell.poses import Array, exp_xi, from_pose6
from fakes.frames.rack_view import RackView
from fakes.world.rack.rack import Rack
from fakes.world.rack.truth import SlotMarkerTruth
from fakes.world.scenario import Scenario
from fakes.world.world import World

OPENING = Rectangle(0.041, 0.021)
KNOWN = np.array([0.003, 0.003, 0.003, 0.005, 0.005, 0.005])  # of a slot before it is looked at
LOOK_M = 0.30
MARKER = SlotMarkerTruth(T_slot_marker=[0.003, -0.0245, 0.0, np.pi, 0.0, 0.0])


@dataclass(frozen=True)
class Picture:
    """``T_camera_slot`` as it truly is, and what was known of it before."""

    colour: NDArray[np.uint8]
    depth: NDArray[np.uint16]
    camera: Intrinsics
    T_camera_slot: RigidTransform
    expected: Expected


def make_rack(flange: Callable[[float], RigidTransform] = lambda t: RigidTransform.identity()) -> Rack:
    """The scenario's rack beside an arm whose flange is where ``flange`` has it."""
    truth = Scenario.load("slot").world.rack
    assert truth is not None
    return Rack(truth, lambda t: flange(t).as_matrix(), 0.0)


def look_at(number: int, rng: np.random.Generator, tick: int = 0, marked: bool = False) -> Picture:
    """Slot ``number`` from about straight before it; ``marked``: with a marker beside each slot."""
    world, rack, view = _scene(marked)
    off = exp_xi(rng.normal(size=6) * [0.003, 0.003, 0.003, 0.01, 0.01, 0.01])
    T_base_camera = rack.T_base_slot(number) * RigidTransform.from_translation([0, 0, -LOOK_M]) * off
    colour, depth = view.drawn(T_base_camera, 0.0, tick)
    T = T_base_camera.inv() * rack.T_base_slot(number)
    expected = Expected(T * exp_xi(rng.normal(size=6) * KNOWN), np.diag(KNOWN**2))
    return Picture(colour, depth, world.intrinsics, T, expected)


def blank(like: Picture) -> NDArray[np.uint8]:
    """A plate without openings."""
    return np.full_like(like.colour, 120)


def spread(cov: Array) -> Array:
    return np.sqrt(np.diag(cov))


def marker_at(number: int, sigma_m: float = 0.0, sigma_rad: float = 0.0) -> SlotMarker:
    """The one beside slot ``number`` of a marked rack, as known to this."""
    table = {"type": "aruco-marker", **MARKER.model_dump(exclude={"T_slot_marker", "id"})}
    target = make_target({**table, "id": MARKER.id + number - 1})
    cov = np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
    return SlotMarker(target, "the marker", MARKER.size_m, 6, from_pose6(MARKER.T_slot_marker), cov)


@cache
def _scene(marked: bool) -> tuple[World, Rack, RackView]:
    scenario = Scenario.load("slot")
    if marked:
        assert scenario.world.rack is not None
        rack = scenario.world.rack.model_copy(update={"marker": MARKER})
        truth = scenario.world.model_copy(update={"rack": rack})
        scenario = scenario.model_copy(update={"world": truth})
    world = World.from_scenario(scenario)
    assert world.rack is not None
    return world, world.rack, RackView(world, world.rack)
