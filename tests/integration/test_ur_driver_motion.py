"""Moves through the genuine client in its child process, against a controller on the wire."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ur_driver_rig import TOOL, Rig, own_pauses, rests, untouched
from ur_motion_scene import SPEED, joints, quintic, rig, shared, turned

from cell.devices import ArmState, Speed, ToolSettings, TrajectoryPiece
from cell.errors import error
from cell.poses import from_pose6
from cell.samples import Sample
from cell.testing.taken_again import ends_by
from drivers.ur.motion import UrMotion
from drivers.ur.motion_client import MotionClient
from fakes.world.scenario import Scenario
from tests.kit.ideal_world import ideal_text

__all__ = ["rig", "shared"]
pytestmark = pytest.mark.wire


def test_a_joint_move_ends_where_the_truth_says(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            target = turned(arm, 0.3)
            await port.move_joints(target, SPEED)
            np.testing.assert_allclose(rig.truth()["q"], target, atol=1e-3)
            assert rig.truth()["payload_kg"] == pytest.approx(1.2)
            assert arm.health()["motion_child"] is not None
        assert rig.truth()["program"] is None

    rig.play(scenario)


def test_a_linear_move_brings_the_flange_to_its_pose(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            start_pose = arm.state.latest(0.5).value.T_base_flange
            target = from_pose6([0.03, 0.04, -0.05, 0.0, 0.0, 0.0]) * start_pose
            await port.move_linear(target, SPEED)
            reached = arm.state.latest(0.5).value.T_base_flange
            np.testing.assert_allclose(reached.translation, target.translation, atol=5e-4)
            tcp = from_pose6(rig.truth()["tcp_pose"])
            expected = target * TOOL.T_flange_tool
            np.testing.assert_allclose(tcp.translation, expected.translation, atol=5e-4)
            assert (tcp.rotation.inv() * expected.rotation).magnitude() < 1e-3

    rig.play(scenario)


def test_setting_the_tcp_starts_an_epoch_and_keeps_the_flange(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected() as arm:
            await arm.wait_fresh(1.0)
            epoch, flange = arm.state.epoch, arm.state.latest(0.5).value.T_base_flange
            port = await arm.open_motion(ToolSettings(from_pose6([0.01, 0.0, 0.123, 0.0, 0.1, 0.0]), 0.4))
            await arm.wait_fresh(1.0)
            assert arm.state.epoch == epoch + 1
            after = arm.state.latest(0.5).value
            np.testing.assert_allclose(after.tcp_offset6, [0.01, 0, 0.123, 0, 0.1, 0], atol=1e-9)
            np.testing.assert_allclose(after.T_base_flange.translation, flange.translation, atol=1e-9)
            await port.close()
            await asyncio.sleep(0.6)
            # The primary port agrees, so nothing changes when it takes over again.
            assert arm.state.epoch == epoch + 1

    rig.play(scenario)


def followed_in_time(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            travel = np.array([0.2, 0.0, 0.0, 0.0, 0.1, 0.0])
            piece = quintic(time.monotonic() + 0.3, 0.8, joints(arm), travel)

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                yield piece

            await port.stream(pieces())
            await rests(arm, 1.0)
            np.testing.assert_allclose(joints(arm), piece.coefficients[0] + travel, atol=1e-3)
            middle = [s for s in arm.state.between(piece.t0, piece.t1) if abs(s.value.qd[0]) > 0.3]
            lags = [s.t - _instant_of(piece, s.value.q[0]) for s in middle]
            # The arm follows with the servo's look-ahead, not with a delay of its own.
            assert 0.0 < np.median(lags) < 0.12

    rig.play(scenario)


def test_a_streamed_trajectory_is_followed_in_time(rig: Rig) -> None:
    followed_in_time(rig)


def test_a_cb3_with_its_125_hz_follows_in_time_too() -> None:
    with Rig.running(version="3.15.0", model="ur10") as rig:
        followed_in_time(rig)


def _instant_of(piece: TrajectoryPiece, q: float) -> float:
    t = np.linspace(0.0, piece.t1 - piece.t0, 4000)
    planned = np.polynomial.polynomial.polyval(t, piece.coefficients[:, 0])
    return piece.t0 + float(np.interp(q, planned, t))


def test_a_stream_that_is_not_renewed_ends_in_rest_and_says_so(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            q0, t0 = joints(arm), time.monotonic() + 0.3

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                yield TrajectoryPiece(t0, t0 + 0.3, np.array([q0, [0.3, 0, 0, 0, 0, 0]]))
                await asyncio.sleep(5.0)

            async with own_pauses() as pauses:
                with ends_by("MOTION_WATCHDOG", match="not renewed"):
                    await port.stream(pieces())
            await rests(arm, 1.0)
            untouched(pauses)  # the stream ends earlier, too, when the beat is late
            assert 0.08 < joints(arm)[0] - q0[0] < 0.12

    rig.play(scenario)


@pytest.mark.parametrize("pause_s", [0.06, 0.15, 0.6])
def test_an_arm_that_stood_as_the_motion_client_paused_is_not_said_not_to_follow(
    pause_s: float, rig: Rig
) -> None:
    """Whoever compares the arm with its set-points sees it first; the cause is that none were sent."""

    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            q0, begin, speed = joints(arm), time.monotonic() + 0.3, 0.5
            client = port.client
            asyncio.get_running_loop().call_later(0.8, os.kill, client.pid, signal.SIGSTOP)
            asyncio.get_running_loop().call_later(0.8 + pause_s, os.kill, client.pid, signal.SIGCONT)
            lag: list[float] = []

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                t = begin
                while t < begin + 1.5:
                    newest = arm.state.latest(1.0)
                    q = q0 + np.array([speed * (t - begin), 0, 0, 0, 0, 0])
                    yield TrajectoryPiece(t, t + 0.15, np.array([q, [speed, 0, 0, 0, 0, 0]]))
                    lag.append(speed * max(newest.t - begin, 0.0) - newest.value.q[0] + q0[0])
                    if lag[-1] > lag[0] + 0.05:
                        raise error("ARM_NOT_FOLLOWING", f"{lag[-1]:.3f} rad")
                    await asyncio.sleep(max(t + 0.008 - time.monotonic(), 0.0))
                    t = max(t + 0.02, time.monotonic() + 0.012)

            with ends_by("MOTION_WATCHDOG"):
                await port.stream(pieces())
            await rests(arm, 1.0)

    rig.play(scenario)


async def a_failed_stream(port: UrMotion, q0: np.ndarray) -> None:
    """Its arm moved, and the client has still to hold the last set-point for a while."""
    t0 = time.monotonic() + 0.2

    async def pieces() -> AsyncIterator[TrajectoryPiece]:
        yield TrajectoryPiece(t0, t0 + 0.4, np.array([q0, [0.2, 0, 0, 0, 0, 0]]))
        await asyncio.sleep(0.1)
        raise error("STALE_DATA", "whatever ends a step")

    with ends_by("STALE_DATA", match="whatever"):
        await port.stream(pieces())


@pytest.mark.parametrize("then", ["move", "stream"])
def test_what_follows_a_stream_that_failed_waits_until_the_client_has_settled(then: str, rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            q0 = joints(arm)
            await a_failed_stream(port, q0)
            if then == "move":
                await port.move_joints(q0, SPEED)
                np.testing.assert_allclose(joints(arm), q0, atol=1e-3)
                return
            await rests(arm, 1.0)
            here = joints(arm)

            async def back() -> AsyncIterator[TrajectoryPiece]:
                yield quintic(time.monotonic() + 0.1, 0.5, here, q0 - here)

            await port.stream(back())
            np.testing.assert_allclose(joints(arm), q0, atol=1e-3)

    rig.play(scenario)


def test_a_move_is_not_begun_when_the_arm_was_lost_while_the_client_settled(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    call = MotionClient.call

    async def noted(client: MotionClient, do: str, *args: Any, **kwargs: Any) -> Any:
        asked.append(do)
        return await call(client, do, *args, **kwargs)

    monkeypatch.setattr(MotionClient, "call", noted)

    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            q0 = joints(arm)
            await a_failed_stream(port, q0)
            lost = error("STALE_DATA", "nobody sees the arm")
            asyncio.get_running_loop().call_later(0.02, port.interrupt, lost)
            with ends_by("STALE_DATA", match="nobody sees"):
                await port.move_joints(q0, SPEED)
            await rests(arm, 1.0)
            assert "follow" in asked
            assert "move_joints" not in asked

    rig.play(scenario)


def test_a_stream_that_begins_elsewhere_is_refused_at_rest(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            q0 = joints(arm)

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                now = time.monotonic()
                yield TrajectoryPiece(now, now + 0.5, np.array([q0 + 0.2]))

            with ends_by("MOTION_LIMIT"):
                await port.stream(pieces())
            np.testing.assert_allclose(rig.truth()["q"], q0, atol=1e-6)

    rig.play(scenario)


def test_a_guarded_move_without_contact_ends_after_its_travel(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            start_pose = arm.state.latest(0.5).value.T_base_flange
            target = from_pose6([0.0, 0.0, -0.2, 0.0, 0.0, 0.0]) * start_pose
            assert not await port.guarded_move(target, SPEED, max_force_n=20.0, max_travel_m=0.05)
            travel = arm.state.latest(0.5).value.T_base_flange.translation - start_pose.translation
            np.testing.assert_allclose(travel, [0.0, 0.0, -0.05], atol=1e-3)

    rig.play(scenario)


def z_speed(before: ArmState, after: ArmState) -> float:
    """Of the TCP between two packages, m/s by the controller's clock."""
    return float((after.tcp_pose6[2] - before.tcp_pose6[2]) / (after.stamp - before.stamp))


def test_a_guarded_move_stops_at_the_force(tmp_path: Path) -> None:
    text = ideal_text("hand_eye")
    surface = (
        "[[world.obstacle]]\npoint = [0.0, 0.0, 0.45]\nnormal = [0.0, 0.0, 1.0]\nstiffness_n_m = 5000.0\n"
    )
    scenario_file = tmp_path / "table.toml"
    scenario_file.write_text(text + "\n" + surface, "utf-8")
    force_n, speed_m_s, decel_m_s2 = 20.0, 0.02, 0.5
    above = np.array(Scenario.parse(text).world.arm.q_start)

    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            await port.move_joints(above, SPEED)  # from wherever a pause may have ended it
            await asyncio.sleep(0.1)
            state = arm.state.latest(2.0).value
            assert state.tcp_pose6[2] > 0.47
            target = from_pose6([0.0, 0.0, -0.06, 0.0, 0.0, 0.0]) * state.T_base_flange
            samples: list[Sample[ArmState]] = []
            stops: list[float] = []  # the newest stamp at each
            post = port.client.post

            def noting(do: str, **arguments: Any) -> None:
                stops.append(samples[-1].t)
                post(do, **arguments)

            port.client.post = noting  # type: ignore[method-assign]
            arm.state.subscribe(samples.append)  # before the port's own look at the same sample
            slow = Speed(speed_m_s, decel_m_s2, 0.5, 1.0)
            assert await port.guarded_move(target, slow, max_force_n=force_n, max_travel_m=0.2)
            await rests(arm, 1.0)
            over = [s for s in samples if s.value.tcp_force[2] > force_n]
            slower = next(a for a, b in pairwise(over) if z_speed(a.value, b.value) > -0.9 * speed_m_s)
            assert stops[0] <= over[0].t, "the stop is sent from within the sample that shows the force"
            # From there on the arm goes as far as a stop needs, however late this machine was before.
            z = arm.state.latest(2.0).value.tcp_pose6[2]
            assert slower.value.tcp_pose6[2] - z < speed_m_s**2 / (2.0 * decel_m_s2) + 0.0005
            assert z < 0.45 - force_n / 5000.0 + 0.0005

    with Rig.running(scenario=scenario_file) as rig:
        rig.play(scenario)
