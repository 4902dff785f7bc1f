"""The arm's state against a controller on the wire, beside the genuine client where it can judge."""

import asyncio
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from ur_driver_rig import LASTING, TOOL, Rig, until

from cell.clock import MonotonicClock
from cell.devices import SafetyMode
from cell.errors import CellError
from drivers.ur import UrArm
from drivers.ur.rtde_link import RtdeLink

pytestmark = pytest.mark.wire


@pytest.fixture(scope="module")
def shared() -> Iterator[Rig]:
    with Rig.running() as rig:
        yield rig


@pytest.fixture
def rig(shared: Rig, request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The module's controller, or one of its own for a test that spoils it."""
    call = getattr(request.node, "callspec", None)
    if call is not None and call.params.get("fault") in LASTING:
        with Rig.running() as own:
            yield own
    else:
        yield shared
        shared.tidy()


@pytest.fixture
def own() -> Iterator[Rig]:
    """A controller that the test may spoil."""
    with Rig.running() as rig:
        yield rig


def code(caught: pytest.ExceptionInfo[CellError]) -> str:
    return caught.value.name


def test_the_genuine_receiver_reads_the_same_state(rig: Rig) -> None:
    from rtde_receive import RTDEReceiveInterface

    async def ours() -> Any:
        async with rig.connected() as subject:
            await subject.wait_fresh(1.0)
            return subject.state.latest(0.1).value

    state = asyncio.run(ours())
    genuine = RTDEReceiveInterface(rig.host)
    try:
        np.testing.assert_allclose(state.q, genuine.getActualQ(), atol=1e-12)
        np.testing.assert_allclose(state.tcp_pose6, genuine.getActualTCPPose(), atol=1e-12)
        np.testing.assert_allclose(state.tcp_force, genuine.getActualTCPForce(), atol=1e-12)
        assert state.robot_mode == genuine.getRobotMode()
        assert state.safety_mode == genuine.getSafetyMode()
        assert state.digital_in == genuine.getActualDigitalInputBits()
        assert 0.0 < genuine.getTimestamp() - state.stamp < 5.0
    finally:
        genuine.disconnect()


def test_every_package_that_the_controller_sends_becomes_a_sample(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected() as subject:
            await subject.wait_fresh(1.0)
            before = rig.truth()["lost_cycles"]
            received, gaps = subject.state.received, subject.state.gaps
            await asyncio.sleep(1.0)
            received, gaps = subject.state.received - received, subject.state.gaps - gaps
            assert gaps <= rig.truth()["lost_cycles"] - before
            assert received + gaps > 480
            stamps = [s.t for s in subject.state.between(0.0, time.monotonic())]
            assert np.median(np.diff(stamps)) == pytest.approx(0.002, abs=1e-4)

    rig.play(scenario)


def test_identity_and_factory_kinematics_are_read(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected(model="ur10e") as subject:
            identity = await subject.identify()
        assert (identity.model, identity.version) == ("ur10e", "5.12.4")
        assert identity.serial == rig.truth()["serial"]
        assert identity.is_twin
        assert len(identity.extra["kinematics"]["checksum"]) == 6
        np.testing.assert_allclose(identity.extra["kinematics"]["calibration"]["delta_d"], 0.0, atol=1e-9)
        np.testing.assert_allclose(np.degrees(identity.extra["joint_ranges_rad"]), [[-363.0, 363.0]] * 6)
        assert identity.extra["joint_speeds_rad_s"][0] == pytest.approx(np.deg2rad(120.0) + 0.2)

    rig.play(scenario)


@pytest.mark.parametrize("expectation", [{"expect_serial": "20235500123"}, {"model": "ur5e"}])
def test_another_robot_than_expected_is_refused(rig: Rig, expectation: dict) -> None:
    async def scenario() -> None:
        async with rig.connected(**expectation) as subject:
            with pytest.raises(CellError, match=next(iter(expectation.values()))) as caught:
                await subject.identify()
            assert code(caught) == "DEVICE_IDENTITY"

    rig.play(scenario)


def test_a_dead_address_is_unreachable() -> None:
    async def scenario() -> None:
        subject = UrArm("arm", UrArm.Config(host="127.0.0.39", connect_timeout_s=1.0), MonotonicClock())
        with pytest.raises(CellError) as caught:
            await subject.open()
        assert code(caught) == "DEVICE_UNREACHABLE"
        with pytest.raises(CellError):
            subject.check_movable()

    asyncio.run(scenario())


@pytest.mark.parametrize("fault", ["handshake-message", "split", "duplicate", "delay"])
def test_a_difficult_link_gives_the_same_samples(rig: Rig, fault: str) -> None:
    async def scenario() -> None:
        async with rig.connected() as subject:
            await subject.wait_fresh(2.0)
            await asyncio.sleep(0.3)
            np.testing.assert_allclose(subject.state.latest(0.2).value.q, rig.truth()["q"], atol=1e-9)
            assert subject.lost is None
            assert (subject.feed.repeated > 50) == (fault == "duplicate")

    rig.inject(fault)
    asyncio.run(scenario())


def test_left_out_packages_are_counted(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected() as subject:
            await subject.wait_fresh(1.0)
            gaps = subject.state.gaps
            await asyncio.to_thread(rig.inject, "gap", count=20)
            await asyncio.sleep(0.2)
            assert subject.state.gaps - gaps >= 20
            assert subject.lost is None

    rig.play(scenario)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("drop", "DEVICE_LOST"),
        ("reset", "DEVICE_LOST"),
        ("junk", "PROTOCOL_VIOLATION"),
        ("silence", "DEVICE_LOST"),
        ("freeze", "DEVICE_LOST"),
        ("half-open", "DEVICE_LOST"),
    ],
)
def test_a_broken_link_is_reported_with_its_code(rig: Rig, fault: str, name: str) -> None:
    async def scenario() -> None:
        async with rig.connected(lost_after_s=0.1) as subject:
            await subject.wait_fresh(1.0)
            await asyncio.to_thread(rig.inject, fault)
            async with asyncio.timeout(2.0):
                failure = await subject.wait_lost()
            last = subject.state.last()
            assert last is not None
            # Measured from the last package: at once when the link says so, 0.1 s when it is only silent.
            assert subject.lost_at - last.t < 0.25
            assert isinstance(failure, CellError)
            assert failure.name == name
            assert str(subject.fault()) == str(failure)
            with pytest.raises(CellError):
                await subject.wait_fresh(0.1)

    rig.play(scenario)


def test_silence_is_stale_before_it_is_lost(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected(stale_after_s=0.02, lost_after_s=1.0) as subject:
            await subject.wait_fresh(1.0)
            await asyncio.to_thread(rig.inject, "silence")
            await asyncio.sleep(0.05)
            with pytest.raises(CellError) as caught:
                subject.check_movable()
            assert code(caught) == "STALE_DATA"
            assert subject.lost is None

    rig.play(scenario)


def test_a_controller_that_restarts_within_a_connection_is_found_out(own: Rig) -> None:
    async def scenario() -> None:
        async with own.connected() as subject:
            await asyncio.sleep(0.2)
            await asyncio.to_thread(own.inject, "clock-jump", s=100.0)
            await until(lambda: subject.state.latest(1.0).value.stamp > 100.0)
            assert subject.lost is None
            await asyncio.to_thread(own.inject, "clock-jump", s=-50.0)
            async with asyncio.timeout(2.0):
                failure = await subject.wait_lost()
            assert isinstance(failure, CellError)
            assert failure.name == "ARM_REBOOTED"

    asyncio.run(scenario())


def test_after_a_reboot_the_same_driver_connects_again_and_sees_the_other_arm(own: Rig) -> None:
    async def scenario() -> None:
        serial = own.truth()["serial"]
        async with own.connected(expect_serial=serial) as subject:
            epoch = subject.state.epoch
            await asyncio.sleep(1.0)
            await asyncio.to_thread(own.inject, "reboot", off_s=0.3, serial="99990000077")
            async with asyncio.timeout(2.0):
                await subject.wait_lost()
            for _ in range(40):
                try:
                    await subject.open()
                    break
                except CellError:
                    await asyncio.sleep(0.1)
            assert subject.state.epoch > epoch
            assert subject.health()["reboots"] == 1
            fault = subject.fault()
            assert isinstance(fault, CellError)
            assert fault.name == "ARM_REBOOTED"
            with pytest.raises(CellError, match="99990000077") as caught:
                await subject.identify()
            assert code(caught) == "DEVICE_IDENTITY"

    asyncio.run(scenario())


def test_a_late_first_package_fails_the_open_in_time(rig: Rig) -> None:
    async def scenario() -> None:
        started = time.monotonic()
        with pytest.raises(CellError) as caught:
            async with rig.connected(connect_timeout_s=0.5):
                pass
        assert code(caught) == "DEVICE_LOST"
        assert time.monotonic() - started < 3.0

    rig.inject("late-first-package", s=5.0)
    asyncio.run(scenario())


def test_a_variable_that_the_controller_lacks_is_named(rig: Rig) -> None:
    async def scenario() -> None:
        with pytest.raises(CellError, match="runtime_state") as caught:
            async with rig.connected():
                pass
        assert code(caught) == "PROTOCOL_VIOLATION"

    rig.inject("not-found", name="runtime_state")
    asyncio.run(scenario())


def test_a_deaf_dashboard_forbids_motion_but_not_reading(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected() as subject:
            await asyncio.to_thread(rig.inject, "slow-dashboard", s=5.0)
            await until(lambda: subject.health()["remote_control"] is None)
            await subject.wait_fresh(0.5)
            with pytest.raises(CellError) as caught:
                subject.check_movable()
            assert code(caught) == "ARM_NOT_READY"

    rig.play(scenario)


def test_reading_and_probing_leave_a_foreign_program_alone(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected() as subject:
            await until(lambda: subject.feed.runtime_state == 2)
            await subject.identify()
            with pytest.raises(CellError) as caught:
                subject.check_movable()
            assert code(caught) == "ARM_PROGRAM_RUNNING"
        assert rig.truth()["program"] == "foreign"

    rig.inject("foreign-program")
    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("protective-stop", "ARM_PROTECTIVE_STOP"),
        ("local-mode", "ARM_LOCAL_MODE"),
    ],
)
def test_a_stopped_arm_at_rest_is_a_coded_fault(rig: Rig, fault: str, name: str) -> None:
    async def scenario() -> None:
        async with rig.connected() as subject:
            subject.check_movable()
            await asyncio.to_thread(rig.inject, fault)
            await until(lambda: subject.fault() is not None)
            with pytest.raises(CellError) as caught:
                subject.check_movable()
            assert code(caught) == name
            assert subject.lost is None

    rig.play(scenario)


@pytest.mark.parametrize(
    ("version", "model", "rate_hz", "tells_tcp"),
    [("3.15.0", "ur10", 125, True), ("5.5.0", "ur10e", 500, False), ("5.23.0", "ur10e", 500, True)],
)
def test_other_controller_versions_are_read_and_moved(
    version: str, model: str, rate_hz: int, tells_tcp: bool
) -> None:
    async def scenario(rig: Rig) -> None:
        async with rig.connected(model=model) as subject:
            assert (await subject.identify()).version == version
            port = await subject.open_motion(TOOL)
            await subject.wait_fresh(1.0)
            sample = subject.state.last()
            assert sample is not None
            np.testing.assert_allclose(sample.value.tcp_offset6, [0, 0, 0.18, 0, 0, 0], atol=1e-9)
            assert sample.dt == pytest.approx(0.5 / rate_hz)
            assert subject._tcp_in_packages == tells_tcp
            await port.close()
            assert subject.state.gaps < 10

    with Rig.running(version=version, model=model) as rig:
        rig.play(lambda: scenario(rig))


def test_polyscope_x_is_refused_by_its_version() -> None:
    async def opened(rig: Rig) -> None:
        async with rig.connected():
            raise AssertionError("it was opened")

    wanted = r"PolyScope X \(10\.11\.0"
    with (
        Rig.running(version="10.11.0", model="ur10e") as rig,
        pytest.raises(CellError, match=wanted) as caught,
    ):
        asyncio.run(opened(rig))
    assert code(caught) == "ARM_NOT_SUPPORTED"


def test_a_port_that_is_closed_names_the_service_that_may_be_off() -> None:
    async def opened() -> None:
        arm = UrArm("arm", UrArm.Config(host="127.0.0.39"), MonotonicClock())
        await arm.open()

    with pytest.raises(CellError, match=r"service RTDE may be off .*Security, Services"):
        asyncio.run(opened())


def test_registers_that_somebody_else_holds_are_named_and_left_alone(rig: Rig) -> None:
    async def work() -> None:
        async with rig.connected() as subject:
            assert await subject.doubts() == []
            link = await RtdeLink.connect(rig.host, MonotonicClock(), lambda failure: None, 2.0)
            try:
                await link.setup_inputs(["input_int_register_1", "input_double_register_4"], 2.0)
                (doubt,) = await subject.doubts()
            finally:
                link.close()
            assert "input_int_register_1, input_double_register_4 are in use by a fieldbus" in doubt
            await asyncio.sleep(0.2)
            assert await subject.doubts() == []

    rig.play(work)


def test_a_probe_tells_of_reduced_mode_in_which_no_job_starts(rig: Rig) -> None:
    async def work() -> None:
        async with rig.connected() as subject:
            await asyncio.to_thread(rig.inject, "reduced-mode")
            await until(lambda: subject.state.last().value.safety_mode == SafetyMode.REDUCED)
            (doubt,) = await subject.doubts()
            assert "in reduced mode, and jobs are refused with ARM_NOT_READY" in doubt
            fault = subject.fault()
            assert fault is not None
            assert fault.name == "ARM_NOT_READY"
            await asyncio.to_thread(rig.inject, "clear")
            await until(lambda: subject.state.last().value.safety_mode == SafetyMode.NORMAL)
            assert await subject.doubts() == []

    rig.play(work)


def test_a_probe_tells_of_a_speed_slider_below_full_speed(rig: Rig) -> None:
    async def work() -> None:
        async with rig.connected() as subject:
            await asyncio.to_thread(rig.inject, "speed-slider", fraction=0.5)
            await until(lambda: subject.state.last().value.speed_scaling < 1.0)
            (doubt,) = await subject.doubts()
            assert "speed slider stands at 50 %" in doubt
            assert "Set it to 100 %" in doubt
            await asyncio.to_thread(rig.inject, "clear")
            await until(lambda: subject.state.last().value.speed_scaling == 1.0)
            assert await subject.doubts() == []

    rig.play(work)
