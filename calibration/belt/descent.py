"""The last of the way onto an item: down only as far as what is beside allows."""

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, Trajectory

from calibration.belt.pursuit import Leg, Origin, PursuitLimits, PursuitState, plan
from cell.poses import Array

TOUCH_M = 0.0005  # so high above the item's face fingers may be in contact
BESIDE_M = 0.0002
HOLD_M = 0.0015  # low, to be down soon; and more than an item's height is wrong
_THERE_M = 0.0005  # of it, and the tool may go on down


def descend(
    t0: float,
    state: PursuitState,
    origin: Origin,
    offset: Array,
    limits: PursuitLimits,
    cautious: bool = False,
) -> Leg:
    """Each axis to rest at ``offset`` (4,) from ``origin``, the middle of an item's upper face, as early as
    it can; but a tool that would touch while it is still beside its goal, because the belt does otherwise
    than predicted, stays above the face.

    A tool too low to stop above goes on. One that is ``cautious`` always comes to rest just above the face
    before the touch: it can wait there when the belt changes late. Errors as of
    :func:`calibration.belt.pursuit.plan`.
    """
    straight = plan(t0, state, origin, offset, limits, apart=True)
    touches = touch_height(offset)
    touch, gap = straight.down_at(touches), straight.gap(t0)
    over = max(_beside(straight, t0), _beside(straight, touch)) <= BESIDE_M
    face = touches - TOUCH_M
    if over and not (cautious and gap.p[2] > face + HOLD_M + _THERE_M):
        return straight
    low = _stop(gap, limits)
    if low <= touches:
        return straight
    above = np.array([0.0, 0.0, min(low, face + HOLD_M), 0.0])
    return plan(t0, state, origin, offset + above, limits, apart=True)


def touch_height(offset: Array) -> float:
    """How high over the end of a way to ``offset`` (4,) from the middle of an item's face the tool may touch
    it, m: a way may go on down beside the item."""
    return max(-float(offset[2]), 0.0) + TOUCH_M


def _beside(leg: Leg, t: float) -> float:
    gap = leg.gap(t).p
    return float(np.hypot(gap[0], gap[1]))


def _stop(gap: PursuitState, limits: PursuitLimits) -> float:
    """How high above its goal a tool ends that only brakes, m."""
    wanted = InputParameter(1)
    wanted.control_interface = ControlInterface.Velocity
    wanted.current_position, wanted.current_velocity = [gap.p[2]], [gap.v[2]]
    wanted.current_acceleration = [gap.a[2]]
    wanted.target_velocity, wanted.target_acceleration = [0.0], [0.0]
    wanted.max_acceleration, wanted.max_jerk = [limits.a], [limits.j]
    braking = Trajectory(1)
    Ruckig(1).calculate(wanted, braking)
    return float(braking.at_time(braking.duration)[0][0])
