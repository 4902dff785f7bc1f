"""The motion port of the object face: the documented promises of ``MotionPort`` in virtual time."""

import asyncio
import weakref
from collections.abc import AsyncIterator, Awaitable
from math import inf
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.clock import Clock
from cell.devices import ArmState, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError, error
from cell.poses import Array, compose
from cell.samples import Readings
from fakes.object.controller import Controller
from fakes.world.arm.kinematics import UnreachableError, rotation_vector
from fakes.world.arm.segments import Polynomial
from fakes.world.arm.servo import lag_s
from fakes.world.world import World

T = TypeVar("T")

STOP_DECEL_M_S2 = 5.0
FORCE_PERIOD_S = 0.002
MAX_STREAM_STEP_RAD = 0.05
LATE_S = 0.01
WIRE_S = 0.004  # from here into force; 4 to 6 ms on a real one (Universal_Robots_Client_Library issue 86)


class Settings(Protocol):
    """Keys of the arm's driver that its motion goes by."""

    @property
    def state_period_s(self) -> float: ...
    @property
    def stale_after_s(self) -> float: ...
    @property
    def joint_tolerance_rad(self) -> float: ...
    @property
    def position_tolerance_m(self) -> float: ...
    @property
    def rotation_tolerance_rad(self) -> float: ...
    @property
    def servo_lookahead_s(self) -> float: ...
    @property
    def servo_gain(self) -> float: ...


class MovedArm(Protocol):
    """What a port needs of its arm."""

    name: str
    controller: Controller
    world: World
    lost: CellError | None
    connections: int

    @property
    def clock(self) -> Clock: ...
    @property
    def config(self) -> Settings: ...
    @property
    def state(self) -> Readings[ArmState]: ...
    async def take_tool(self, tool: ToolSettings) -> None: ...
    def next_change(self) -> asyncio.Future[None]: ...
    async def wait_change(self, timeout: float = inf) -> None: ...


class ObjectMotionPort:
    """One run of our control script. After any fault it is dead; the next lease opens another."""

    def __init__(self, arm: MovedArm, run: int) -> None:
        self._arm, self._run = arm, run
        self._controller, self._world, self._clock = arm.controller, arm.world, arm.clock
        self._dead: CellError | None = None
        self._connection = arm.connections
        self._ended_by: CellError | None = None  # before it was closed
        self._sent: Polynomial | None = None  # the newest piece of a stream
        self._brake = STOP_DECEL_M_S2  # no gentler than the move is, or a stop would carry past its end
        # Whoever drops the port without closing it stops kicking the watchdog.
        self._left = weakref.finalize(self, arm.controller.abandon, run)

    @property
    def usable(self) -> bool:
        """False once our script ended for a silence of ours; ``ARM_SCRIPT_DIED`` when others ended it."""
        trouble = self._ended_by if self.closed else self._dead or self._trouble()
        if trouble is None:
            return not self.closed and not self._cut_off
        if trouble.name in ("MOTION_WATCHDOG", "STALE_DATA", "DEVICE_LOST"):
            return False
        raise error(trouble.name, trouble.detail)

    @property
    def ended_unseen(self) -> bool:
        """True once the link to the arm was lost while our script ran."""
        return self._cut_off

    @property
    def _cut_off(self) -> bool:
        """The link to the arm was lost meanwhile: the motion process ends with it."""
        return self._arm.connections != self._connection

    @property
    def closed(self) -> bool:
        """True once :meth:`close` was called."""
        return not self._left.alive

    async def move_joints(self, q: Array, speed: Speed) -> None:
        """Returns when the measured joints agree, else raises the fault or ``ARM_NOT_AT_TARGET``."""
        await self._enter()
        now = self._clock.now()
        self._brake = max(STOP_DECEL_M_S2, speed.joint_rad_s2)
        slider = self._controller.speed_fraction
        self._world.track.start_joint_move(now, q, speed.joint_rad_s * slider, speed.joint_rad_s2)
        await self._until_rest()
        await self._check_joints(np.asarray(q, dtype=float))

    async def move_linear(self, T_base_flange: RigidTransform, speed: Speed) -> None:
        """Returns when the flange is measured there, else raises."""
        await self._enter()
        self._start_linear(T_base_flange, speed)
        await self._until_rest()
        await self._check_flange(T_base_flange)

    async def guarded_move(
        self, T_base_flange: RigidTransform, speed: Speed, max_force_n: float, max_travel_m: float
    ) -> bool:
        """True when the force ended it, False at the target or at the travel limit."""
        await self._enter()
        now = self._clock.now()
        start, bias = self._world.believed_flange(now), self._force(now)
        goal = _shortened(start, T_base_flange, max_travel_m)
        self._start_linear(goal, speed)
        while self._world.track.end_time > now:
            if np.linalg.norm(self._force(now) - bias) >= max_force_n:
                self._world.track.stop_linear(now, self._brake)
                await self._until_rest()
                return True
            await self._watched(self._clock.sleep(FORCE_PERIOD_S))
            now = self._clock.now()
        await self._check_flange(goal)
        return False

    async def stream(self, pieces: AsyncIterator[TrajectoryPiece]) -> None:
        """Follow polynomials; when they end the arm ramps to rest, then this returns.

        ``MOTION_WATCHDOG`` when a piece came too late and the arm was ramped to rest, ``MOTION_LIMIT`` when
        a piece does not begin where the arm is.
        """
        await self._enter()
        source, ends = aiter(pieces), inf
        self._sent = None
        self._controller.stream_time.begin()
        while (piece := await self._next_piece(source, ends)) is not None:
            self._follow(piece)
            ends = piece.t1
        await self._until_rest()

    async def _next_piece(
        self, source: AsyncIterator[TrajectoryPiece], ends: float
    ) -> TrajectoryPiece | None:
        try:
            async with asyncio.timeout(None if ends == inf else ends + LATE_S - self._clock.now()):
                return await self._watched(anext(source, None))
        except TimeoutError:
            await self._until_rest()
            raise error("MOTION_WATCHDOG", "no piece of the stream followed in time") from None

    def _follow(self, piece: TrajectoryPiece) -> None:
        start = max(piece.t0, self._clock.now())
        if start >= piece.t1:
            return
        before, self._sent = self._sent, Polynomial(start, piece.t1, piece.t0, piece.coefficients)
        here = self._world.track.at(start)[0] if before is None else before.at(start)[0]
        step = float(np.max(np.abs(self._sent.at(start)[0] - here)))
        if step > MAX_STREAM_STEP_RAD:
            raise error("MOTION_LIMIT", f"a set-point of the stream jumps by {step:.3f} rad")
        config = self._arm.config
        more = self._world.config.arm.servo.more_s
        late = WIRE_S + lag_s(config.servo_lookahead_s, config.servo_gain) + more
        self._controller.stream_time.follow(self._sent, late)

    async def set_tool(self, tool: ToolSettings) -> None:
        """Another TCP and payload, at rest."""
        await self._enter()
        await self._arm.take_tool(tool)

    async def decelerate(self) -> None:
        """End whatever moves and brake; harmless at rest, ``DEVICE_LOST`` without a link."""
        await self._perhaps_hang()
        if self._arm.lost is not None:
            raise error(self._arm.lost.name, self._arm.lost.detail)
        if self._controller.runs(self._run):
            self._controller.settle_past()
            self._world.track.stop_linear(self._clock.now(), self._brake)
            self._controller.announce()

    async def close(self) -> None:
        """End our script."""
        await self._perhaps_hang()
        if not self.closed:
            self._ended_by = self._dead or self._trouble()
        self._left.detach()
        self._dead = self._dead or error("INTERNAL", "a motion port was used after it was closed")
        if self._arm.lost is not None:
            self._controller.abandon(self._run)
        else:
            self._controller.settle_past()
            self._controller.end_ours(self._run)
            self._controller.announce()

    # -- what can go wrong

    async def _enter(self) -> None:
        await self._perhaps_hang()
        if self._arm.lost is None and self._cut_off:
            raise error("CHILD_DIED", f"the motion process of {self._arm.name} ended with the link")
        self._raise_trouble()
        self._controller.settle_past()

    async def _perhaps_hang(self) -> None:
        if self._controller.hanging_calls > 0:
            self._controller.hanging_calls -= 1
            await asyncio.Event().wait()

    def _raise_trouble(self) -> None:
        self._dead = self._dead or self._trouble()
        if self._dead is not None:
            raise error(self._dead.name, self._dead.detail)

    def _trouble(self) -> CellError | None:
        """What ended this run of the script, or makes it blind."""
        if self._arm.lost is not None:
            return self._arm.lost
        sample = self._arm.state.last()
        limit = self._arm.config.stale_after_s
        if sample is not None and self._clock.now() - sample.t > limit:
            return error("STALE_DATA", f"{self._arm.name}: no state for more than {limit:g} s")
        if self._controller.died_of is not None:
            return self._controller.died_of
        if not self._controller.runs(self._run):
            return error("ARM_SCRIPT_DIED", f"{self._arm.name}: the program was stopped")
        return None

    async def _until_rest(self) -> None:
        """Wait while the arm is planned to move; faults come out at once."""
        while (left := self._world.track.end_time - self._clock.now()) > 0.0:
            self._raise_trouble()
            await self._arm.wait_change(min(left, self._blind_limit()))
        self._raise_trouble()

    async def _watched(self, work: Awaitable[T]) -> T:
        """Await ``work``; a fault ends the wait and comes out instead."""
        task = asyncio.ensure_future(work)
        try:
            while not task.done():
                self._raise_trouble()
                limit = self._blind_limit()
                waits: set[asyncio.Future[Any]] = {task, self._arm.next_change()}
                await asyncio.wait(
                    waits, timeout=None if limit == inf else limit, return_when=asyncio.FIRST_COMPLETED
                )
            return task.result()
        finally:
            if not task.done():
                task.cancel()
                await asyncio.wait({task})

    def _blind_limit(self) -> float:
        """How long to wait at most before looking again; short only while the state is silent."""
        return self._arm.config.stale_after_s if self._controller.silent else inf

    # -- motion and its proof

    def _start_linear(self, T_base_flange: RigidTransform, speed: Speed) -> None:
        T_flange_tcp = self._controller.T_flange_tcp
        self._brake = max(STOP_DECEL_M_S2, speed.tcp_m_s2)
        try:
            self._world.track.start_linear_move(
                self._clock.now(),
                self._world.believed,
                compose(T_base_flange, T_flange_tcp),
                T_flange_tcp,
                speed.tcp_m_s * self._controller.speed_fraction,
                speed.tcp_m_s2,
            )
        except UnreachableError as exc:
            self._controller.inject("script-death")
            raise error("ARM_SCRIPT_DIED", f"no inverse kinematics: {exc}") from exc

    def _force(self, t: float) -> Array:
        """What the sensor shows: the contact, and what wanders without one."""
        wrench = self._world.contact_force(t, self._controller.T_flange_tcp) + self._world.reported.force(t)
        return wrench[:3]

    async def _check_joints(self, q: Array) -> None:
        measured = await self._measured_joints()
        off = float(np.max(np.abs(measured - q)))
        if off > self._arm.config.joint_tolerance_rad:
            raise error("ARM_NOT_AT_TARGET", f"{self._arm.name}: a joint is {off:.4f} rad off")

    async def _check_flange(self, T_base_flange: RigidTransform) -> None:
        measured = self._world.believed.matrix(await self._measured_joints())
        wanted = T_base_flange.as_matrix()
        off_t = float(np.linalg.norm(measured[:3, 3] - wanted[:3, 3]))
        off_r = float(np.linalg.norm(rotation_vector(wanted[:3, :3].T @ measured[:3, :3])))
        config = self._arm.config
        if off_t > config.position_tolerance_m or off_r > config.rotation_tolerance_rad:
            detail = f"{self._arm.name}: flange is {off_t * 1e3:.2f} mm and {off_r:.4f} rad off"
            raise error("ARM_NOT_AT_TARGET", detail)

    async def _measured_joints(self) -> Array:
        """Joints of a sample taken after the end of the motion; ``STALE_DATA`` when none comes."""
        ended = self._clock.now()
        while True:
            await self._watched(self._clock.sleep(self._arm.config.state_period_s))
            sample = self._arm.state.latest(self._arm.config.stale_after_s)
            if sample.t >= ended:
                return sample.value.q


def _shortened(start: RigidTransform, goal: RigidTransform, longest_m: float) -> RigidTransform:
    """``goal``, or the pose on the way to it after ``longest_m``."""
    way = goal.translation - start.translation
    length = float(np.linalg.norm(way))
    if length <= longest_m:
        return goal
    part = longest_m / length
    turn = Rotation.from_rotvec(part * (start.rotation.inv() * goal.rotation).as_rotvec())
    return RigidTransform.from_components(start.translation + part * way, start.rotation * turn)
