"""The observed arm as a thing: where its joints are, what its program does, and what its controller shows.

Everything is a function of the twin's time (s). The program goes to a pose that it is asked for after a
while, as somebody who first looks around; it knows its limits and says at which pose it stands. Every face
shares this, so what the arm itself does wrong lives here; what goes wrong on a link lives in the face.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.poses import Array, to_pose6
from fakes.world.arm.repeatability import Repeatability
from fakes.world.arm.track import Track
from fakes.world.palletizer.joint_errors import palletizer_joint_errors
from fakes.world.palletizer.linkage import JOINTS, Palletizer
from fakes.world.palletizer.truth import ObservedTruth
from fakes.world.timeline import Timeline

MOVING_RAD_S = 1e-6
HISTORY_S = 120.0


class Status(IntEnum):
    """What the controller's status register says."""

    IDLE = 0
    BUSY = 1  # a request was taken, the arm sets out or moves
    THERE = 2  # the arm stands at the pose that was asked for
    REFUSED = 3  # the pose that was asked for is outside the arm's limits


class ObservedPalletizer:
    """The palletizer of a world, from ``t0`` on."""

    axes = JOINTS

    def __init__(self, truth: ObservedTruth, seed: int, t0: float) -> None:
        self.truth = truth
        self.believed = Palletizer.from_mapping(truth.parameters.model_dump())
        self.true = Palletizer.from_mapping(truth.true_parameters)
        self.errors = palletizer_joint_errors(truth.joint_errors, self.true, seed)
        self.track = Track(t0, truth.q_start, keep_s=HISTORY_S)
        self.listeners: list[Callable[[float], None]] = []  # told before anything changes that was planned
        self._repeatability = Repeatability(seed + 1, truth.repeatability_t_m, truth.repeatability_r_rad)
        self.track.listeners.append(self._repeatability.add)
        self._status: Timeline[Status] = Timeline(Status.IDLE)
        self._reached: Timeline[int] = Timeline(0)
        self._stuck: list[Timeline[float | None]] = [Timeline(None) for _ in range(JOINTS)]
        self._last_q = np.array(truth.q_start, dtype=float)
        self._last_number = 0
        self._skip = self._disorder = False

    # -- what is so

    def true_flange(self, t: float) -> RigidTransform:
        """``T_base_flange`` as it truly is."""
        return RigidTransform(self.true_matrix(t), normalize=False, copy=False)

    def true_matrix(self, t: float) -> Array:
        """The same as (4, 4)."""
        out: Array = self.true.matrix(self._actual(t)) @ self._repeatability.matrix(t)
        return out

    def lines(self, t: float) -> Array:
        """(5, 2, 3) m: its links, see :meth:`fakes.world.palletizer.linkage.Palletizer.lines`."""
        return self.true.lines(self._actual(t))

    def _actual(self, t: float) -> Array:
        """Motor-side joints (4,) rad at which it truly stands."""
        q = self.track.at(t)[0]
        return q if self.errors is None else self.errors.actual(q)

    def believed_flange(self, t: float) -> RigidTransform:
        """``T_base_flange`` as the controller computes it."""
        return self.believed.flange(self.track.at(t)[0])

    # -- what the controller shows

    def joints(self, t: float) -> Array:
        """Motor-side joints (4,) rad; one that is stuck shows what it showed when that began."""
        q = self.track.at(t)[0]
        shown = [stuck.at(t) for stuck in self._stuck]
        return np.array([x if held is None else held for x, held in zip(q, shown, strict=True)])

    def moving(self, t: float) -> bool:
        """Whether any joint turns."""
        return bool(np.max(np.abs(self.track.at(t)[1])) > MOVING_RAD_S)

    def status(self, t: float) -> Status:
        return self._status.at(t)

    def reached(self, t: float) -> int:
        """The number of the pose that the program says it stands at; 0 for none."""
        return self._reached.at(t)

    def report(self, t: float) -> dict[str, Any]:
        """What a result may be judged against at ``t``, as plain JSON values."""
        return {
            "model": self.truth.model,
            "serial": self.truth.serial,
            "robot": self.truth.robot,
            "parameters": self.truth.true_parameters,
            "joint_errors": [] if self.errors is None else self.errors.told(),
            "q": self.track.at(t)[0].tolist(),
            "T_base_flange": to_pose6(self.true_flange(t)).tolist(),
            "pose": self.reached(t),
            "status": self.status(t).name.lower(),
        }

    # -- what is asked of the program

    def request(self, t: float, number: int, q: ArrayLike) -> Status:
        """Pose ``number`` with joints ``q`` (4,) rad is wanted; 0 takes back what has not begun.

        A pose outside the limits is refused, and the arm stays where it is.
        """
        self._announce(t)
        if number == 0:
            return self._withdraw(t)
        wanted = np.array(q, dtype=float)
        if not self.within(wanted):
            self._status.put(t, Status.REFUSED)
            return Status.REFUSED
        told, target = number, wanted
        if self._skip:
            self._skip, target = False, self.track.at(self.track.end_time)[0]
        elif self._disorder:
            self._disorder, told, target = False, self._last_number, self._last_q
        self._last_number, self._last_q = number, wanted
        self._status.put(t, Status.BUSY)
        begin = t + self.truth.reaction_s
        end = self._move(begin, target)
        self._reached.put(begin, 0)
        self._reached.then(end, told)
        self._status.then(end, Status.THERE)
        return Status.BUSY

    def go(self, t: float, q: ArrayLike) -> float:
        """Move to ``q`` (4,) rad at once, as somebody at the pendant; returns when the arm rests there."""
        self._announce(t)
        return self._move(t, q)

    def _move(self, t: float, q: ArrayLike) -> float:
        if self.track.end_time <= t and np.array_equal(self.track.at(t)[0], q):
            return t
        return self.track.start_joint_move(t, q, self.truth.speed_rad_s, self.truth.accel_rad_s2)

    def _announce(self, t: float) -> None:
        for listener in tuple(self.listeners):
            listener(t)

    def _withdraw(self, t: float) -> Status:
        """A move that has begun ends where it was to end, and is told."""
        if self.moving(t):
            return self._status.at(t)
        if self.track.end_time > t:
            self.track.hold(t)
            self._reached.put(t, self._reached.at(t))
        self._status.put(t, Status.IDLE)
        return Status.IDLE

    def within(self, q: ArrayLike) -> bool:
        """Whether joints (4,) rad are within the arm's limits."""
        wanted = np.array(q, dtype=float)
        if wanted.shape != (JOINTS,):
            return False
        low, high = np.array(self.truth.limits).T
        return bool(np.all((low <= wanted) & (wanted <= high)))

    # -- faults

    def stick(self, t: float, joint: int | None = None) -> None:
        """From ``t`` on the register of ``joint`` (counted from 1, None is all) keeps its value."""
        now = self.joints(t)
        for i in range(JOINTS) if joint is None else (joint - 1,):
            self._stuck[i].put(t, float(now[i]))

    def free(self, t: float) -> None:
        """From ``t`` on all registers live again."""
        for stuck in self._stuck:
            if stuck.at(t) is not None:
                stuck.put(t, None)

    def jog(self, t: float, rad: float) -> None:
        """At ``t`` somebody jogs every joint by ``rad``; the program still says that it stands there."""
        low, high = np.array(self.truth.limits).T
        q = self.track.at(t)[0]
        self.go(t, np.clip(np.where(q + rad <= high, q + rad, q - rad), low, high))

    def skip_next(self) -> None:
        """The program will say that it is at the next pose without having gone there."""
        self._skip = True

    def disorder_next(self) -> None:
        """At the next request the program goes where the last one was, and says so."""
        self._disorder = True

    def clear(self, t: float) -> None:
        """End every fault that lasts."""
        self.free(t)
        self._skip = self._disorder = False
