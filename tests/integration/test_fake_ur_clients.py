"""What UR's own clients and ur-rtde ask of a controller beyond the everyday: whole recipes, lost clients.

UR's clients are not installed here. Their recipes and the replies that their tests expect are taken from
the public sources: RTDE_Python_Client_Library (examples/record_configuration_v2.xml) and
Universal_Robots_Client_Library (tests/test_rtde_client.cpp, tests/fake_rtde_server.cpp).
"""

import time
from collections.abc import Iterator

import pytest
from fake_ur_client import Lines, Rtde, Text, genuine

from fakes.ur.process import ControllerHandle, running_controller

pytestmark = pytest.mark.wire
HOST = "127.0.0.13"

# The output recipe of the C++ library's RTDE tests.
DRIVER_OUTPUTS = (
    "timestamp,actual_q,actual_qd,speed_scaling,target_speed_fraction,runtime_state,actual_TCP_force,"
    "actual_TCP_pose,actual_digital_input_bits,actual_digital_output_bits,standard_analog_input0,"
    "standard_analog_input1,standard_analog_output0,standard_analog_output1,analog_io_types,tool_mode,"
    "tool_analog_input_types,tool_analog_input0,tool_analog_input1,tool_output_voltage,"
    "tool_output_current,tool_temperature,robot_mode,safety_mode,robot_status_bits,safety_status_bits,"
    "actual_current,tcp_offset"
)
DRIVER_INPUTS = (
    "speed_slider_mask,speed_slider_fraction,standard_digital_output_mask,standard_digital_output,"
    "configurable_digital_output_mask,configurable_digital_output,tool_digital_output_mask,"
    "tool_digital_output,standard_analog_output_mask,standard_analog_output_type,"
    "standard_analog_output_0,standard_analog_output_1"
)
# The configuration that UR's recording example is shipped with: name and type.
SHIPPED = {
    "timestamp": "DOUBLE",
    **dict.fromkeys(("target_q", "target_qd", "target_qdd", "target_current"), "VECTOR6D"),
    **dict.fromkeys(("target_moment", "actual_q", "actual_qd", "actual_current"), "VECTOR6D"),
    **dict.fromkeys(("joint_control_output", "actual_TCP_pose", "actual_TCP_speed"), "VECTOR6D"),
    **dict.fromkeys(("actual_TCP_force", "target_TCP_pose", "target_TCP_speed"), "VECTOR6D"),
    "actual_digital_input_bits": "UINT64",
    "joint_temperatures": "VECTOR6D",
    "actual_execution_time": "DOUBLE",
    "robot_mode": "INT32",
    "joint_mode": "VECTOR6INT32",
    "safety_status": "INT32",
    "actual_tool_accelerometer": "VECTOR3D",
    **dict.fromkeys(("speed_scaling", "target_speed_fraction", "actual_momentum"), "DOUBLE"),
    **dict.fromkeys(("actual_main_voltage", "actual_robot_voltage", "actual_robot_current"), "DOUBLE"),
    "actual_joint_voltage": "VECTOR6D",
    "actual_digital_output_bits": "UINT64",
    "runtime_state": "UINT32",
    "joint_position_deviation_ratio": "DOUBLE",
}
# Variables that it names beside them, with the types of the C++ library.
RECORDED = {
    "tool_output_mode": "UINT8",
    "tool_digital_output0_mode": "UINT8",
    "tool_digital_output1_mode": "UINT8",
    "script_control_line": "UINT32",
    "euromap67_input_bits": "UINT32",
    "euromap67_24V_voltage": "DOUBLE",
    "joint_position_deviation_ratio": "DOUBLE",
    "collision_detection_ratio": "DOUBLE",
    "actual_configurable_digital_input_bits": "UINT64",
    "actual_TCP_acceleration": "VECTOR6D",
    "wrench_calc_from_currents": "VECTOR6D",
    "encoder0_raw": "INT32",
    "time_scale_source": "INT32",
}


@pytest.fixture(scope="module")
def subject() -> Iterator[ControllerHandle]:
    with running_controller(HOST) as controller:
        yield controller


def test_the_recipes_of_the_client_library_are_served_and_streamed(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        assert "NOT_FOUND" not in link.outputs(DRIVER_OUTPUTS, 25.0)
        recipe, types = link.inputs(DRIVER_INPUTS)
        assert recipe == 1
        assert "NOT_FOUND" not in types
        assert link.start()
        assert len(link.next("U")) > 300


@pytest.mark.parametrize("recorded", [SHIPPED, SHIPPED | RECORDED])
def test_a_recording_gets_the_types_of_its_configuration(
    subject: ControllerHandle, recorded: dict[str, str]
) -> None:
    with Rtde(HOST) as link:
        assert link.outputs(",".join(recorded), 125.0) == ",".join(recorded.values())
        assert link.start()
        link.next("U")


def test_a_new_client_takes_over_from_one_that_died_with_its_script_running(
    subject: ControllerHandle,
) -> None:
    for attempt in range(8):
        # The process leaves by os._exit: the control script of the one before is still there.
        running_before = subject.truth()["program"]
        assert (running_before is not None) is (attempt > 0)
        seen = genuine(HOST, "c = RTDEControlInterface(HOST); seen['up'] = c.isProgramRunning()")
        assert seen["up"] is True


SPECIAL = """
    r, c = RTDEReceiveInterface(HOST), RTDEControlInterface(HOST)
    seen["zeroed"] = [c.zeroFtSensor(), caught_up(r).getActualTCPForce()]

    before = r.getActualTCPPose()
    begun = c.forceMode([0.0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -10.0, 0, 0, 0], 2, [0.05] * 6)
    time.sleep(0.5)
    speed = r.getActualTCPSpeed()
    stopped = c.forceModeStop()
    seen["force"] = [begun, speed, stopped, caught_up(r).getActualTCPSpeed(), before, r.getActualTCPPose()]

    seen["freedrive"] = [c.freedriveMode(), c.getFreedriveStatus(), c.endFreedriveMode()]
    seen["teach"] = [c.teachMode(), c.endTeachMode()]
    seen["settings"] = [c.forceModeSetDamping(0.1), c.forceModeSetGainScaling(1.0)]
    seen["settings"].append(c.setGravity([0, 0, 9.82]))
    q = r.getActualQ()
    seen["move after"] = [c.moveJ([q[0] + 0.05, *q[1:]], 1.0, 4.0), caught_up(r).getActualQ()[0] - q[0]]

    p = r.getActualTCPPose()
    goal = [p[0], p[1] + 0.02, p[2] + 0.02, *p[3:]]
    seen["servoC"] = [c.servoC(goal, 0.25, 1.2, 0.0)]
    time.sleep(1.0)
    seen["servoC"] += [caught_up(r).getActualTCPPose(), goal]
"""


def test_force_freedrive_and_servo_commands_do_what_they_say(subject: ControllerHandle) -> None:
    seen = genuine(HOST, SPECIAL)
    assert seen["zeroed"] == [True, [0.0] * 6]
    begun, speed, stopped, after, before, pose = seen["force"]
    assert (begun, stopped) == (True, True)
    assert speed[2] == pytest.approx(-0.0195, rel=0.02)
    assert max(map(abs, after)) == 0.0
    assert before[2] - pose[2] > 0.005
    assert seen["freedrive"] == [True, 0, True]
    assert seen["teach"] == [True, True]
    assert seen["settings"] == [True, True, True]
    assert seen["move after"] == [True, pytest.approx(0.05)]
    sent, reached, goal = seen["servoC"]
    assert sent is True
    assert reached == pytest.approx(goal, abs=1e-5)


def test_a_refused_command_shows_as_false_and_an_ended_script(subject: ControllerHandle) -> None:
    seen = genuine(
        HOST,
        """
        c = RTDEControlInterface(HOST)
        seen["refused"] = c.ftRtdeInputEnable(True, 0.3)
        seen["running"] = c.isProgramRunning()
        seen["next"] = c.setPayload(1.0, [0, 0, 0.01])
        """,
    )
    assert seen == {"refused": False, "running": False, "next": False}


def test_a_custom_function_with_a_condition_and_variables_is_carried_out(subject: ControllerHandle) -> None:
    seen = genuine(
        HOST,
        """
        r, c = RTDEReceiveInterface(HOST), RTDEControlInterface(HOST)
        body = "q = get_actual_joint_positions()\\n"
        body += "if q[5] < 3:\\n  q[5] = q[5] + 0.1\\n  movej(q, a=6, v=2)\\nend\\n"
        before = r.getActualQ()[5]
        seen["custom"] = [c.sendCustomScriptFunction("turn", body), caught_up(r).getActualQ()[5] - before]
        seen["running"] = c.isProgramRunning()
        """,
    )
    assert seen["custom"] == [True, pytest.approx(0.1)]
    assert seen["running"] is True


def test_a_protective_stop_by_script_is_seen_on_dashboard_and_primary_port(
    subject: ControllerHandle,
) -> None:
    with Text(HOST) as primary, Lines(HOST) as dashboard:
        primary.send("protective_stop()\n")
        deadline = time.monotonic() + 1.0
        while "PROTECTIVE_STOP" not in dashboard.ask("safetystatus") and time.monotonic() < deadline:
            time.sleep(0.01)
        assert dashboard.ask("safetymode") == "Safetymode: PROTECTIVE_STOP"
        for _ in range(3):  # one may have been on its way
            mode = primary.state()[0]
        assert mode[12] == 1  # is the arm protective stopped?
        subject.inject("clear")
