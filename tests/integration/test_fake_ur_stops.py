"""Stops, programs and faults of the fake controller, seen through its own ports and by the genuine client."""

import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from fake_ur_client import Lines, Rtde, Text, genuine

from cell.errors import InputError
from fakes.ur.process import ControllerHandle, running_controller

pytestmark = pytest.mark.wire
HOST = "127.0.0.6"
STATE = "runtime_state,safety_mode,robot_mode,robot_status_bits,safety_status_bits,actual_qd"
LAYOUT = "IiiII6d"
KEY, EXCEPTION = 7, 10
FAR = "def far():\n  movej([1.5,-1.8,1.8,-1.57,-1.57,0],a=2,v=0.8)\nend\n"
NEAR = "def near():\n  movej([0,-1.8,1.8,-1.57,-1.57,0],a=10,v=3)\nend\n"


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerHandle]:
    with running_controller(HOST) as running:
        yield running


@pytest.fixture
def subject(controller: ControllerHandle) -> ControllerHandle:
    """The controller as an operator leaves it, the arm at home."""
    controller.inject("clear")
    with Text(HOST, 30003) as script:
        # Its last line is seen however late we look: the program itself may have come and gone.
        before = _marked(controller)
        mark = f"  set_standard_digital_out(7, {not before})\nend"
        script.send(NEAR.replace("near", "home").replace("end", mark))
        assert _eventually(lambda: _marked(controller) is not before)
        assert _eventually(lambda: controller.truth()["runtime_state"] == "STOPPED")
    return controller


def test_a_protective_stop_pauses_the_program_and_cannot_be_unlocked_at_once(
    subject: ControllerHandle,
) -> None:
    with Text(HOST, 30003) as script, Rtde(HOST) as rtde, Lines(HOST) as dashboard:
        _stream(rtde)
        script.send(FAR)
        _until(rtde, lambda s: abs(s["qd"][0]) > 0.3)
        subject.inject("protective-stop")
        stopped = _until(rtde, lambda s: s["runtime"] == 4)
        assert (stopped["safety"], stopped["status"]) == (3, 1 << 2 | 1 << 10)
        assert not np.any(stopped["qd"])
        assert 0.0 < subject.truth()["q"][0] < 1.5
        assert dashboard.ask("programState").startswith("PAUSED")
        assert dashboard.ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s")
        assert dashboard.ask("play") == "Failed to execute: play"


def test_an_emergency_stop_ends_the_program_and_needs_power_and_brakes(subject: ControllerHandle) -> None:
    with Text(HOST, 30003) as script, Rtde(HOST) as rtde, Lines(HOST) as dashboard:
        _stream(rtde)
        script.send(FAR)
        _until(rtde, lambda s: abs(s["qd"][0]) > 0.3)
        subject.inject("emergency-stop")
        stopped = _until(rtde, lambda s: s["runtime"] == 1 and not np.any(s["qd"]))
        assert (stopped["safety"], stopped["robot"]) == (7, 3)
        assert stopped["status"] & (1 << 7)
        assert not stopped["bits"] & 1
        assert dashboard.ask("play") == "Failed to execute: play"
        dashboard.ask("restart safety")
        dashboard.ask("power on")
        dashboard.ask("brake release")
        _until(rtde, lambda s: s["robot"] == 7 and s["safety"] == 1)
        script.send(NEAR)
        _until(rtde, lambda s: s["runtime"] == 2)
        _until(rtde, lambda s: s["runtime"] == 1)
        assert subject.truth()["q"][0] == pytest.approx(0.0, abs=1e-12)


def test_a_safeguard_stop_can_be_resumed(subject: ControllerHandle) -> None:
    with Text(HOST, 30003) as script, Rtde(HOST) as rtde, Lines(HOST) as dashboard:
        _stream(rtde)
        script.send(FAR)
        _until(rtde, lambda s: abs(s["qd"][0]) > 0.3)
        subject.inject("safeguard-stop", for_s=0.3)
        _until(rtde, lambda s: s["runtime"] == 4 and s["safety"] == 5)
        _until(rtde, lambda s: s["safety"] == 1)
        assert dashboard.ask("play") == "Starting program"
        _until(rtde, lambda s: abs(s["qd"][0]) > 0.3)
        assert dashboard.ask("stop") == "Stopped"
        _until(rtde, lambda s: s["runtime"] == 1 and not np.any(s["qd"]))


@pytest.mark.parametrize("port", [30001, 30003])
@pytest.mark.parametrize("stop", ["stopj(8.0)", "stopl(2.0)"])
def test_an_uploaded_stop_program_replaces_the_running_one(
    subject: ControllerHandle, port: int, stop: str
) -> None:
    with Text(HOST, 30003) as script, Text(HOST, port) as other, Rtde(HOST) as rtde:
        _stream(rtde)
        script.send(FAR)
        _until(rtde, lambda s: abs(s["qd"][0]) > 0.3)
        other.send(f"def halt():\n  {stop}\nend\n")
        _until(rtde, lambda s: s["runtime"] == 1 and not np.any(s["qd"]))
        assert subject.truth()["q"][0] < 1.4


def test_primary_clients_hear_of_programs_and_of_what_is_not_understood(subject: ControllerHandle) -> None:
    with Text(HOST) as primary:
        primary.send(NEAR)
        assert _key(primary) == ("PROGRAM_XXX_STARTED", "near")
        assert _key(primary) == ("PROGRAM_XXX_STOPPED", "near")
        primary.send("def odd():\n  sync()\n  x = force_of_habit(3)\nend\n")
        place = struct.unpack(">ii", (body := primary.message(EXCEPTION))[:8])
        assert place == (3, 7)
        assert body[8:] == b"compile_error_name_not_found:force_of_habit:"
        time.sleep(0.1)
        assert subject.truth()["program"] is None
        primary.send("def threads():\n  thread t():\n    sync()\n  end\nend\n")
        assert b"does not interpret" in primary.message(EXCEPTION)


def test_a_secondary_program_may_set_outputs_but_not_move(subject: ControllerHandle) -> None:
    with Text(HOST) as primary:
        primary.send("sec lamp():\n  set_standard_digital_out(2, True)\nend\n")
        assert _eventually(lambda: subject.truth()["digital_out"] & 4)
        primary.send("sec bad():\n  movej([0,0,0,0,0,0])\nend\n")
        assert b"physical time" in primary.message(EXCEPTION)
        assert subject.truth()["program"] is None


def test_local_mode_reads_but_does_not_obey(subject: ControllerHandle) -> None:
    with Lines(HOST) as dashboard, Text(HOST, 30003) as script:
        subject.inject("local-mode")
        assert dashboard.ask("is in remote control") == "false"
        assert dashboard.ask("power off").startswith("Command is not allowed")
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
        script.send(FAR)
        time.sleep(0.1)
        assert subject.truth()["program"] is None


def test_a_reboot_closes_the_ports_and_begins_a_new_time_with_another_serial(
    subject: ControllerHandle,
) -> None:
    with Rtde(HOST) as before:
        before.outputs("timestamp")
        before.start()
        time.sleep(0.3)
        subject.inject("reboot", off_s=0.5, serial="99990000777")
        with pytest.raises(OSError):  # noqa: PT011 - reset or refused, as the moment has it
            for _ in range(5000):
                before.doubles()
        with pytest.raises(ConnectionRefusedError):
            Rtde(HOST)
    assert _eventually(lambda: _accepts(HOST))
    with Lines(HOST) as dashboard, Rtde(HOST) as after:
        assert dashboard.ask("get serial number") == "99990000777"
        assert dashboard.ask("robotmode") == "Robotmode: POWER_OFF"
        after.outputs("timestamp")
        after.start()
        assert after.doubles()[0] < 2.0


@pytest.mark.parametrize(("fault", "error"), [("drop", ConnectionError), ("reset", ConnectionResetError)])
def test_connections_end_with_fin_or_with_rst(
    subject: ControllerHandle, fault: str, error: type[Exception]
) -> None:
    with Rtde(HOST) as link:
        link.ask("v")
        subject.inject(fault)
        with pytest.raises(error):
            link.next("v")
    assert _accepts(HOST)


def test_stream_faults_show_in_the_stamps(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        link.outputs("timestamp")
        link.start()

        last = link.doubles()[0]

        def stamps(count: int = 40) -> Any:
            nonlocal last
            values = [last, *(link.doubles()[0] for _ in range(count))]
            last = values[-1]
            return np.diff(values)

        subject.inject("gap", count=20)
        assert _eventually(lambda: np.isclose(stamps(10).max(), 0.042))
        subject.inject("clock-jump", s=100)
        assert _eventually(lambda: np.isclose(stamps(10).max(), 100.002))
        subject.inject("duplicate", for_s=0.3)
        assert _eventually(lambda: bool(np.any(stamps() == 0.0)))
        assert _eventually(lambda: bool(np.all(stamps() > 0.0)))
        subject.inject("freeze", for_s=0.3)
        assert _eventually(lambda: bool(np.all(stamps(10) == 0.0)))
        subject.inject("silence", for_s=0.3)
        assert _eventually(lambda: stamps(10).max() > 0.2)
        subject.inject("split", for_s=0.3)
        np.testing.assert_allclose(stamps(100), 0.002, atol=1e-9)
        subject.inject("delay", s=0.1, for_s=0.4)
        assert _eventually(lambda: bool(np.all(stamps(20) > 0.0)))


def test_a_fault_with_a_wrong_name_or_argument_is_refused_in_words(subject: ControllerHandle) -> None:
    with pytest.raises(InputError, match=r"no fault 'meltdown'; it has .*protective-stop"):
        subject.inject("meltdown")
    with pytest.raises(InputError, match="gap does not take number; it takes count"):
        subject.inject("gap", number=3)


def test_the_genuine_client_sees_the_stops_as_on_a_real_arm(subject: ControllerHandle) -> None:
    seen = genuine(
        HOST,
        """
        r, c, d = RTDEReceiveInterface(HOST), RTDEControlInterface(HOST), DashboardClient(HOST)
        d.connect()
        seen["no solution"] = [c.getInverseKinematics([9, 0, 0, 0, 0, 0]), c.isProgramRunning()]
        c.reuploadScript()
        time.sleep(0.1)
        q = r.getActualQ()
        c.moveJ([q[0] + 1, *q[1:]], 0.2, 2.0, True)
        time.sleep(0.3)
        d.stop()
        stopped(c, r)
        seen["dashboard stop"] = [c.isProgramRunning(), max(map(abs, r.getActualQd())), c.isSteady()]
        c.reuploadScript()
        time.sleep(0.1)
        c.setWatchdog(2.0)
        for _ in range(8):
            c.kickWatchdog()
            time.sleep(0.1)
        seen["kicked"] = c.isProgramRunning()
        c.moveJ([q[0] - 1, *q[1:]], 0.2, 2.0, True)
        stopped(c, r)
        seen["not kicked"] = [c.isProgramRunning(), max(map(abs, r.getActualQd()))]
        """,
    )
    assert seen["no solution"] == [[], False]
    assert seen["dashboard stop"] == [False, 0.0, False]
    assert seen["kicked"] is True
    assert seen["not kicked"] == [False, 0.0]


def test_the_genuine_client_names_the_reason_when_it_may_not_connect(subject: ControllerHandle) -> None:
    connect = """
        try:
            RTDEControlInterface(HOST)
            seen["error"] = ""
        except RuntimeError as exc:
            seen["error"] = str(exc)
        """
    subject.inject("register-in-use", name="input_int_register_0")
    assert "in use" in genuine(HOST, connect)["error"].lower()
    subject.inject("clear")
    subject.inject("local-mode")
    assert "remote control" in genuine(HOST, connect)["error"].lower()
    subject.inject("clear")
    assert genuine(HOST, connect)["error"] == ""


def _stream(link: Rtde) -> None:
    link.outputs(STATE)
    assert link.start()


def _until(link: Rtde, condition: Callable[[dict[str, Any]], bool], timeout: float = 5.0) -> dict[str, Any]:
    """The first state for which ``condition`` holds."""
    deadline = time.monotonic() + timeout
    while True:
        runtime, safety, robot, bits, status, *qd = link.value(LAYOUT)
        state = {
            "runtime": runtime,
            "safety": safety,
            "robot": robot,
            "bits": bits,
            "status": status,
            "qd": qd,
        }
        if condition(state):
            return state
        assert time.monotonic() < deadline, f"last state {state}"


def _key(primary: Text) -> tuple[str, str]:
    body = primary.message(KEY)
    size = body[8]
    return body[9 : 9 + size].decode(), body[9 + size :].decode()


def _accepts(host: str) -> bool:
    try:
        with Rtde(host):
            return True
    except OSError:
        return False


def _marked(controller: ControllerHandle) -> bool:
    return bool(controller.truth()["digital_out"] >> 7 & 1)


def _eventually(condition: Callable[[], bool], timeout: float = 10.0) -> bool:
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True
