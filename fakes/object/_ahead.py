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
    """Joints, joint speeds and the TCP's pose at some of the times at which ``segment`` is in force."""

    def __init__(self, world: World, segment: Segment, T_flange_tcp: Array, times: Sequence[float]) -> None:
        self.segment, self.T_flange_tcp, self._times = segment, T_flange_tcp, times
        q, qd = world.reported.joints_at(times, *states(segment, times))
        T = world.believed.matrix(q) @ T_flange_tcp
        turned = [rotation_vector_of(R) for R in T[:, :3, :3].tolist()]
        poses = np.concatenate([T[:, :3, 3], turned], axis=1)
        for array in (q, qd, poses):
            array.flags.writeable = False
        self._told = {t: told for t, *told in zip(times, q, qd, poses, strict=True)}

    def at(self, t: float) -> list[Array] | None:
        """``q``, ``qd`` and ``tcp_pose6``, (6,) each, read only; None of a time that is not there."""
        return self._told.get(t)


def ticks_ahead(segment: Segment, t: float, period_s: float) -> int:
    """How many ticks from ``t`` on to foresee: a set-point is replaced before the next one."""
    if isinstance(segment, Polynomial | Smoothed | Rippled):
        return 1
    left = segment.t_end - t
    return _TICKS if left <= 0.0 or left >= _TICKS * period_s else int(left / period_s) + 1
