"""The arm's motion port: moves given to the motion child, believed only when the state stream agrees."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import ExitStack
from functools import partial
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.clock import Clock
from cell.devices import ArmState, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError, error
from cell.poses import Array, from_pose6, to_pose6
from cell.priority import LOOP, process_in_real_time
from cell.samples import Sample
from drivers.ur.config import UrConfig
from drivers.ur.feed import StateFeed
from drivers.ur.motion_checks import finite, open_failure, same_pose, shortened
from drivers.ur.motion_child import BEAT_LIMIT_S
from drivers.ur.motion_client import MotionClient
from drivers.ur.pieces import Following, rest_after
from drivers.ur.script_end import ScriptEnd, ScriptRecord
from drivers.ur.watch import REST_SAMPLES, ArmView, Judge, Watch, drop, joints_judge, pose_judge, until

OPEN_DEADLINE_S = 8.0  # the client itself waits 5 s for its script to start
START_SEEN_S = 3.0  # and another process may pause meanwhile
CALL_DEADLINE_S = 1.0
TOOL_DEADLINE_S = 2.0  # three commands to the script, at rest
STOP_DEADLINE_S = 0.3
END_DEADLINE_S = 0.8
START_MARGIN_S = 3.0
SETTLED_S = 3.0  # a client that holds its last set-point does so for four look-aheads, 0.8 s at most


class MotionArm(ArmView, Protocol):
    """What the port needs of the arm that opened it."""

    feed: StateFeed
    cycle_hz: float  # of the controller, which takes a set-point in each cycle

    async def stop_program(self) -> None: ...
    def tcp_read_back(self, offset6: Array) -> None: ...
    def motion_closed(self) -> None: ...


class UrMotion:
    """Implements ``cell.devices.MotionPort`` on one motion child. Calls must not overlap."""

    def __init__(self, arm: MotionArm, client: MotionClient, tool: ToolSettings, config: UrConfig) -> None:
        self.client = client
        self.script = ScriptRecord(client.kicks, 1.0 / config.watchdog_min_hz)
        self._arm, self._tool, self._config = arm, tool, config
        self._clock: Clock = client.clock
        self._brake = config.stop_decel_m_s2
        self._closed = False
        self._watching: Watch | None = None  # the latest motion
        self._until = partial(until, arm, config)
        self._stop_following_program = arm.state.subscribe(self._note_program)
        self._urgent = ExitStack()
        self._urgent.enter_context(process_in_real_time(LOOP))  # for as long as the arm may move

    @property
    def usable(self) -> bool:
        """Whether our script still runs. False where a silence of ours ended it, or a silence of the arm
        hides who did; ``ARM_SCRIPT_DIED`` or ``CHILD_DIED`` where something else did."""
        end = self.script.end
        if end is ScriptEnd.OTHERS:
            raise error("ARM_SCRIPT_DIED", "no program is running on the arm any more")
        if self._closed or self._arm.lost is not None or self.client.killed or self.client.gave_up:
            return False
        if self.client.ended.is_set():
            raise self.client.death()
        return end is ScriptEnd.NONE and not self.client.withheld

    @property
    def ended_unseen(self) -> bool:
        """Whether a silence of the arm hides who ended our script."""
        return self.script.end is ScriptEnd.UNSEEN

    @property
    def owns_program(self) -> bool:
        """Whether the program that runs on the arm is ours."""
        return self.script.runs

    async def prepare(self) -> None:
        """Upload the script, set the watchdog, the TCP and the payload, and see them in force."""
        self.script.expect()
        try:
            await self._call(
                "open",
                OPEN_DEADLINE_S,
                host=self._config.host,
                watchdog_hz=self._config.watchdog_min_hz,
                servo_period_s=1.0 / self._arm.cycle_hz,
            )
        except CellError as exc:
            raise open_failure(exc) from exc
        await self._until_script_runs()
        await self._set_tool()

    async def _until_script_runs(self) -> None:
        """Wait for the script's start, or for its end: a client that pauses right after it lets it end."""

        def seen() -> bool:
            return self.owns_program or self.script.end is not ScriptEnd.NONE

        await self._until(seen, START_SEEN_S, "the control script's start")
        if self.owns_program:
            return
        if self.script.end is ScriptEnd.OURS:
            raise error("MOTION_WATCHDOG", "the motion client was late right after the script's start")
        raise error("ARM_SCRIPT_DIED", f"right after its start: {self.script.end.value}")

    async def set_tool(self, tool: ToolSettings) -> None:
        """Set another TCP and payload while at rest, and see them in force."""
        self._tool = tool
        await self._set_tool()

    async def move_joints(self, q: Array, speed: Speed) -> None:
        """Joint move; returns when the measured joints rest at ``q`` (6,) rad."""
        await self._settled()
        target = finite(q, (6,), "joint target")
        start = self._newest().value
        leading = float(np.max(np.abs(target - start.q)))
        limit = self._duration(leading, speed.joint_rad_s, speed.joint_rad_s2)
        judge = joints_judge(target, self._config.joint_tolerance_rad, self._clock.now())
        await self._move(
            "move_joints",
            {"q": target.tolist(), "speed": speed.joint_rad_s, "accel": speed.joint_rad_s2},
            judge,
            limit,
        )

    async def move_linear(self, T_base_flange: RigidTransform, speed: Speed) -> None:
        """Linear move of the TCP; returns when the measured TCP rests where the flange has this pose."""
        await self._settled()
        T_base_tcp = T_base_flange * self._tool.T_flange_tool
        await self._linear(T_base_tcp, speed, self._pose_judge(T_base_tcp))

    async def guarded_move(
        self, T_base_flange: RigidTransform, speed: Speed, max_force_n: float, max_travel_m: float
    ) -> bool:
        """Linear move of at most ``max_travel_m``, ended by ``max_force_n``; True when the force ended it.

        The force is the length of the TCP force's change since the start, so a bias does not count. The stop
        is sent from within the sample that shows it.
        """
        await self._settled()
        recent = self._arm.state.between(self._clock.now() - 0.05, self._clock.now())
        if not recent:
            raise error("STALE_DATA", "no force reading in the last 50 ms before a guarded move")
        bias = np.mean([s.value.tcp_force[:3] for s in recent], axis=0)
        T_base_tcp = shortened(
            from_pose6(recent[-1].value.tcp_pose6), T_base_flange * self._tool.T_flange_tool, max_travel_m
        )
        arrived = self._pose_judge(T_base_tcp)

        def judge(sample: Sample[ArmState]) -> Any:
            if np.linalg.norm(sample.value.tcp_force[:3] - bias) >= max_force_n:
                self.client.post("stop", decel=self._brake)
                return "force"
            return arrived(sample)

        touched: bool = await self._linear(T_base_tcp, speed, judge) == "force"
        if touched:
            await self._until_at_rest(2.0)
        return touched

    async def stream(self, pieces: AsyncIterator[TrajectoryPiece]) -> None:
        """Follow polynomials until they end; returns at measured rest on the last set-point.

        Pieces are asked for when the current one ends within 200 ms. The child follows a piece to its end
        only while our beat goes on. ``MOTION_WATCHDOG`` when a piece came too late and the arm was ramped to
        rest, ``MOTION_LIMIT`` when the first piece does not begin where the arm is.
        """
        await self._settled()
        config = self._config
        how = {
            "horizon_s": BEAT_LIMIT_S,
            "ramp": config.follow_decel_rad_s2,
            "lookahead": config.servo_lookahead_s,
            "gain": config.servo_gain,
            "decel": config.stop_decel_m_s2,
        }
        with (
            self._watch(lambda sample: None) as watch,
            Following(self.client, self._arm, watch, config.time_offset_s) as following,
        ):
            try:
                await self._ask(watch, "follow", how)
                last = await following.send(pieces, lambda: self._newest().value.q)
                left = max(last.t1 - self._clock.now(), 0.0) if last is not None else 0.0
                end = await watch.outcome(left + START_MARGIN_S, "following")
            except BaseException as exc:
                self._stop_now()
                if isinstance(exc, CellError):
                    raise following.explained(exc) from None
                raise
        if end != "done":
            raise error("MOTION_WATCHDOG", f"following ended early: {end}")
        if last is not None:
            await self._believe(rest_after(last, config.follow_decel_rad_s2))

    async def decelerate(self) -> None:
        """Ask for a stop.

        A native call that takes longer than ``STOP_DEADLINE_S`` ends the child. One that does not answer
        at all is killed ``GRACE_S`` later, but a stop ladder gives up no later than that: then :meth:`close`
        kills it. In each case the watchdog stops the arm, for nothing kicks it any more.
        """
        if not self.client.ended.is_set():
            await self._call("stop", STOP_DEADLINE_S, decel=self._brake)

    async def close(self) -> None:
        """End our script and the child. A program that someone else started meanwhile is left alone."""
        if self._closed:
            return
        self._closed = True
        self.script.lost = self._arm.lost is not None
        try:
            if self.owns_program and not self.client.killed and not self.client.ended.is_set():
                self.script.ask_end()
                await self._call("end", END_DEADLINE_S)
            else:
                self.client.kill()
        except CellError:
            self.client.kill()
        finally:
            try:
                await self.client.finish(0.3)
                await self._see_program_ended()
            finally:
                self._urgent.close()
                self._stop_following_program()
                self._arm.motion_closed()

    async def _call(self, do: str, deadline_s: float, **arguments: Any) -> Any:
        """A command to the child; a lost link, which ends the child, is named rather than its death."""
        try:
            return await self.client.call(do, deadline_s, **arguments)
        except CellError as exc:
            if (lost := self._arm.lost) is not None:
                raise lost from exc
            raise

    async def _see_program_ended(self) -> None:
        """A script that is paused (after a protective stop) or hangs on is stopped by the dashboard."""
        if self._arm.lost is not None or not self.owns_program:
            return
        try:
            await self._until(lambda: not self.owns_program, 0.3, "the end of the control script")
        except CellError:
            if self.owns_program:
                await self._arm.stop_program()
                await self._until(lambda: not self.owns_program, 1.0, "the end of the control script")

    async def _set_tool(self) -> None:
        tcp = to_pose6(self._tool.T_flange_tool)
        centre = list(self._tool.centre_of_mass)
        if not any(centre):
            # The control script reads exactly zero as "keep the present centre of mass".
            centre[2] = 1e-6
        read = await self._settings({"tcp": tcp.tolist(), "mass": self._tool.payload_kg, "cog": centre})
        found = np.asarray(read, dtype=float)
        if found.shape != (6,) or not same_pose(found, tcp):
            raise error("ARM_TOOL_NOT_SET", f"the TCP was set to {tcp.round(5)}, read back {found.round(5)}")
        self._arm.tcp_read_back(found)
        feed = self._arm.feed
        await self._until(
            lambda: same_pose(feed.tcp_offset6, found), 0.5, f"a TCP of {tcp.round(5)}", "ARM_TOOL_NOT_SET"
        )
        wanted = self._tool.payload_kg
        await self._until(
            lambda: self._payload_is(wanted), 0.5, f"a payload of {wanted:g} kg", "ARM_TOOL_NOT_SET"
        )

    async def _settings(self, arguments: dict[str, Any]) -> Any:
        """What the child read back. A script that ends meanwhile never answers; that is told at once."""
        with Watch(self._arm, self.client, lambda sample: None, self.script) as watch:
            call = asyncio.ensure_future(self._answer("tool", TOOL_DEADLINE_S, arguments))
            try:
                if not await watch.first(call):
                    await watch.outcome(TOOL_DEADLINE_S, "setting the tool")
                return await call
            except CellError as exc:
                if exc.name != "CHILD_DIED":
                    raise
                # Refused, or died: where our script has ended, whoever ended it explains that.
                watch.end_by_script(f"the control script did not take the tool: {exc.detail}")
                try:
                    await watch.outcome(TOOL_DEADLINE_S, "setting the tool")
                except CellError as why:
                    if self.script.end is not ScriptEnd.NONE:
                        raise why from exc
                raise
            finally:
                await drop(call)

    def _payload_is(self, wanted_kg: float) -> bool:
        """True also for controllers that do not report it."""
        payload = self._arm.feed.payload
        return payload is None or abs(payload[0] - wanted_kg) < 1e-3

    def _pose_judge(self, T_base_tcp: RigidTransform) -> Judge:
        c = self._config
        return pose_judge(T_base_tcp, c.position_tolerance_m, c.rotation_tolerance_rad, self._clock.now())

    async def _linear(self, T_base_tcp: RigidTransform, speed: Speed, judge: Judge) -> Any:
        pose = finite(to_pose6(T_base_tcp), (6,), "pose target")
        start = from_pose6(self._newest().value.tcp_pose6)
        travel = float(np.linalg.norm(pose[:3] - start.translation))
        turn = float((start.rotation.inv() * T_base_tcp.rotation).magnitude())
        # A turn on the spot is bound by the same number in rad/s.
        limit = self._duration(travel + turn, speed.tcp_m_s, speed.tcp_m_s2)
        return await self._move(
            "move_linear",
            {"pose": pose.tolist(), "speed": speed.tcp_m_s, "accel": speed.tcp_m_s2},
            judge,
            limit,
        )

    async def _move(self, do: str, arguments: dict[str, Any], judge: Judge, limit_s: float) -> Any:
        # A stop gentler than the move's own braking would carry the arm past the end that was checked.
        self._brake = max(self._config.stop_decel_m_s2, arguments["accel"])
        with self._watch(judge) as watch:
            try:
                await self._ask(watch, do, arguments)
                return await watch.outcome(limit_s, do)
            except BaseException:
                self._stop_now()
                raise

    def interrupt(self, why: CellError) -> None:
        """End the motion that is under way: nobody sees what the arm does. Nothing happens at rest."""
        if self._watching is not None:
            self._watching.end(why)

    def _watch(self, judge: Judge) -> Watch:
        self._watching = Watch(self._arm, self.client, judge, self.script)
        return self._watching

    async def _settled(self) -> None:
        """A trajectory that was broken off is followed until the arm has settled, which is later than it is
        seen at rest. What forbids motion meanwhile raises."""
        if self.client.idle.is_set():
            return
        with self._watch(lambda sample: None) as watch:
            idle = asyncio.ensure_future(self.client.idle.wait())
            try:
                async with asyncio.timeout(SETTLED_S):
                    await watch.first(idle)
            except TimeoutError:
                raise error(
                    "MOTION_WATCHDOG", f"the motion client still follows after {SETTLED_S:g} s"
                ) from None
            finally:
                await drop(idle)
            if watch.over:
                await watch.outcome(SETTLED_S, "settling")

    async def _ask(self, watch: Watch, do: str, arguments: dict[str, Any]) -> None:
        """Give the child a command; what ends the watch meanwhile does not wait for its answer."""
        call = asyncio.ensure_future(self._answer(do, CALL_DEADLINE_S, arguments))
        try:
            if await watch.first(call) and not call.result() and not watch.over:
                watch.end_by_script(f"the control script did not accept {do}")
        finally:
            await drop(call)

    async def _answer(self, do: str, deadline_s: float, arguments: dict[str, Any]) -> Any:
        """A child without an answer in time was late, as the beat may be: another one may be opened."""
        try:
            return await self._call(do, deadline_s, **arguments)
        except CellError as exc:
            if exc.name != "CALL_TIMEOUT":
                raise
            raise error("MOTION_WATCHDOG", f"the motion client did not answer: {exc.detail}") from exc

    def _duration(self, distance: float, speed: float, accel: float) -> float:
        """Twice the time of a trapezoidal profile under the speed slider, and a margin for the start."""
        scale = max(self._arm.feed.speed_fraction, 0.01)
        return START_MARGIN_S + 2.0 * (distance / (speed * scale) + speed / accel)

    def _stop_now(self) -> None:
        """Best effort without waiting; whoever holds the lease runs the whole stop ladder."""
        try:
            self.client.post("stop", decel=self._brake)
        except CellError:
            self.client.kill()

    async def _believe(self, target: Array) -> None:
        """Following ended as planned; now the measured joints have to say the same."""
        judge = joints_judge(target, 5.0 * self._config.joint_tolerance_rad, self._clock.now())
        with self._watch(judge) as watch:
            await watch.outcome(2.0, "coming to rest after following")

    async def _until_at_rest(self, timeout: float) -> None:
        count = 0

        def judge(sample: Sample[ArmState]) -> bool | None:
            nonlocal count
            count = count + 1 if sample.value.at_rest else 0
            return True if count >= REST_SAMPLES else None

        with self._watch(judge) as watch:
            await watch.outcome(timeout, "the stop after contact")

    def _note_program(self, sample: Sample[ArmState]) -> None:
        # A configured offset shifts the arm's samples, and not the kicks that they are compared with.
        self.script.note(self._arm.feed.runtime_state, sample.t + self._config.time_offset_s)

    def _newest(self) -> Sample[ArmState]:
        return self._arm.state.latest(self._config.silent_after_s)
