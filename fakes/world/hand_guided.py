"""A person who jogs the arm until the tool's point truly stands over a point of the target."""

import numpy as np

from cell.poses import Array
from fakes.world.arm.kinematics import Chain
from fakes.world.arm.true_arm import TrueArm

JOG_RAD_S, JOG_RAD_S2 = 0.1, 0.5
_ROUNDS = 4  # each leaves what the arm's errors make of the way that was too long


def joints_over(true: TrueArm, believed: Chain, tool: Array, place: Array, q: Array) -> Array:
    """(6,) rad: joints near ``q`` at which the point ``tool`` (3,) m of the flange is at ``place`` (3,) m of
    the base, the flange turned as it is now."""
    for _ in range(_ROUNDS):
        away = place - true.forward(q).apply(tool)
        flange = believed.forward(q)
        goal = type(flange).from_components(flange.translation + away, flange.rotation)
        q = np.asarray(believed.inverse(goal, q))
    return q
