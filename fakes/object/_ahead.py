"""What an arm will tell at the next ticks of its stream, unless it is commanded something else meanwhile.

Forward kinematics of sixteen sets of joints take twice as long as of one.
"""

from collections.abc import Sequence

import numpy as np

from cell.poses import Array
from fakes.world.arm.kinematics import rotation_vector_of
from fakes.world.arm.ripple import Rippled
from fakes.world.arm.segments import Polynomial, Segment
from fakes.world.arm.smoothed import Smoothed
from fakes.world.arm.sweep import states
from fakes.world.world import World

_TICKS = 16


class Ahead:
    """What is told at some ``stamps`` of the joints, of the TCP's pose, and of a force without a contact.

    ``segment`` is in force at all times at which the told joints were so.
    """

    def __init__(self, world: World, segment: Segment, T_flange_tcp: Array, stamps: Sequence[float]) -> None:
        self.segment, self.T_flange_tcp = segment, T_flange_tcp
        times = [t - world.reported.late_s for t in stamps]
        q, qd = world.reported.joints_at(times, *states(segment, times))
        T = world.believed.matrix(q) @ T_flange_tcp
        turned = [rotation_vector_of(R) for R in T[:, :3, :3].tolist()]
        poses = np.concatenate([T[:, :3, 3], turned], axis=1)
        forces = world.reported.forces(stamps)
        for array in (q, qd, poses, forces):
            array.flags.writeable = False
        self._told = {t: told for t, *told in zip(stamps, q, qd, poses, forces, strict=True)}

    def at(self, t: float) -> list[Array] | None:
        """``q``, ``qd``, ``tcp_pose6`` and the force, (6,) each, read only; None of another stamp."""
        return self._told.get(t)


def ticks_ahead(segment: Segment, t: float, period_s: float) -> int:
    """How many ticks from ``t`` on to foresee: a set-point is replaced before the next one."""
    if isinstance(segment, Polynomial | Smoothed | Rippled):
        return 1
    left = segment.t_end - t
    return _TICKS if left <= 0.0 or left >= _TICKS * period_s else int(left / period_s) + 1
