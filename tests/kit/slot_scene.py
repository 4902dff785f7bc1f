"""A rack as the twin draws it, looked at by a camera on an arm, with the whole truth."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from calibration.slot.opening import Expected
from calibration.slot.rectangle import Rectangle
from cell.devices import Intrinsics
from cell.poses import Array, exp_xi
from fakes.frames.rack_view import RackView
from fakes.world.rack.rack import Rack
from fakes.world.scenario import Scenario
from fakes.world.world import World

OPENING = Rectangle(0.041, 0.021)
KNOWN = np.array([0.003, 0.003, 0.003, 0.005, 0.005, 0.005])  # of a slot before it is looked at
LOOK_M = 0.30


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
    return Rack(truth, flange, 0.0)


def look_at(number: int, rng: np.random.Generator, tick: int = 0) -> Picture:
    """Slot ``number`` from about straight before it."""
    world, rack, view = _scene()
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


@cache
def _scene() -> tuple[World, Rack, RackView]:
    world = World.from_scenario(Scenario.load("slot"))
    assert world.rack is not None
    return world, world.rack, RackView(world, world.rack)
