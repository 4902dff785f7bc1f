"""Programs on the fake controller: reading, running, pausing, and the commands of the control script."""

import ast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.ur.control_script import recognise
from fakes.ur.dashboard import foreign_steps
from fakes.ur.runtime import Program, RuntimeState
from fakes.ur.scripting import TextAssembler
from fakes.ur.urscript import Do, read_program
from tests.kit.fake_ur_stepped import CYCLE, HOME, Stepped


@pytest.fixture
def subject() -> Stepped:
    return Stepped()


@pytest.fixture
def controlled(subject: Stepped) -> Stepped:
    return subject.control()


@given(st.text(max_size=300))
def test_no_text_makes_the_reader_fail(text: str) -> None:
    read_program(text)
    for program in TextAssembler().feed(text.encode() + b"\n"):
        read_program(program)


@given(cuts=st.lists(st.integers(1, 30), max_size=30))
def test_uploads_may_arrive_in_any_pieces(cuts: list[int]) -> None:
    programs = ["def a():\n  sync()\nend\n", "stopj(2)\n", "sec b():\n  sync()\nend\n"]
    stream, assembler, found = "".join(programs).encode(), TextAssembler(), []
    for cut in [*cuts, len(stream)]:
        found += list(assembler.feed(stream[:cut]))
        stream = stream[cut:]
    assert found == programs


def test_a_program_without_an_end_is_given_up() -> None:
    assembler = TextAssembler()
    with pytest.raises(OverflowError):
        for _ in range(2000):
            list(assembler.feed(b"def endless():\n" + b"  sync() # and on it goes\n" * 40))


def test_the_control_script_is_known_by_its_greeting_with_offset_and_path() -> None:
    text = (
        "def rtde_control():\n  global reg_offset_int = # int register offset\n24\n"
        "  def exec_move_path():\n    # inject move path\n\tsignal_async_progress(0)\n"
        "\tmovej([0,0,0,0,0,0],a=1,v=1,r=0)\n\n    end\n"
        '  textmsg("RTDE Control Script Loaded (today)")\nend\n'
    )
    script = recognise(text)
    assert script is not None
    assert script.offset == 24
    assert [ast.unparse(s.value).split("(")[0] for s in script.path if isinstance(s, Do)] == [
        "signal_async_progress",
        "movej",
    ]
    assert recognise("def other():\nend\n") is None


def test_an_uploaded_move_takes_the_time_of_its_trapezoid(subject: Stepped) -> None:
    subject.scripts.take("def go():\n  movej([0.5,-1.8,1.8,-1.57,-1.57,0],a=1,v=0.5)\nend\n")
    subject.until(lambda: subject.robot.runtime.program is not None)
    begin = subject.t
    subject.until(lambda: subject.robot.runtime.state == RuntimeState.STOPPED)
    # 0.5 rad at 0.5 rad/s and 1 rad/s^2: 0.5 s up, 0.5 s at speed, 0.5 s down.
    assert subject.t - begin == pytest.approx(1.5, abs=2 * CYCLE)
    assert subject.q[0] == 0.5
    assert [e[0] for e in subject.events] == ["STARTED", "STOPPED"]


def test_a_new_program_replaces_the_running_one_after_standstill(subject: Stepped) -> None:
    subject.scripts.take("def far():\n  movej([2,-1.8,1.8,-1.57,-1.57,0])\nend\n")
    subject.run(0.5)
    subject.scripts.take("def back():\n  movej([0,-1.8,1.8,-1.57,-1.57,0])\nend\n")
    subject.until(lambda: subject.robot.runtime.program is not None)
    assert not np.any(subject.robot.arm.track.at(subject.t)[1])
    subject.until(lambda: not subject.robot.runtime.active)
    np.testing.assert_allclose(subject.q, HOME)


def test_a_paused_move_is_finished_after_resuming(subject: Stepped) -> None:
    subject.scripts.take("def go():\n  movel(p[-0.6,-0.17,0.6,2.22,2.22,0],v=0.1)\nend\n")
    subject.run(0.3)
    assert subject.dashboard.answer("pause") == "Pausing program"
    subject.until(lambda: subject.robot.runtime.state == RuntimeState.PAUSED)
    resting = subject.q
    subject.run(0.5)
    np.testing.assert_array_equal(subject.q, resting)
    assert subject.dashboard.answer("play") == "Starting program"
    subject.until(lambda: not subject.robot.runtime.active)
    np.testing.assert_allclose(subject.robot.arm.pose6(subject.q)[:3], [-0.6, -0.17, 0.6], atol=1e-9)


def test_after_a_protective_stop_is_unlocked_play_finishes_the_old_move(subject: Stepped) -> None:
    subject.scripts.take("def go():\n  movej([1,-1.8,1.8,-1.57,-1.57,0])\nend\n")
    subject.run(0.5)
    subject.robot.protective_stop()
    subject.run(0.5)
    assert subject.robot.runtime.state == RuntimeState.PAUSED
    assert subject.dashboard.answer("unlock protective stop").startswith("Cannot unlock")
    subject.run(4.6)
    assert subject.dashboard.answer("unlock protective stop") == "Protective stop releasing"
    assert subject.dashboard.answer("play") == "Starting program"
    subject.until(lambda: not subject.robot.runtime.active)
    assert subject.q[0] == 1.0


def test_a_joint_beyond_its_range_is_a_protective_stop(subject: Stepped) -> None:
    subject.robot.arm.track.speed_joints(subject.t, [0, 0, 0, 0, 0, 3.0], 10.0)
    subject.until(lambda: subject.dashboard.answer("safetymode") == "Safetymode: PROTECTIVE_STOP")
    subject.run(1.0)
    assert abs(subject.q[5]) == pytest.approx(np.deg2rad(363.0), abs=0.5)
    assert not np.any(subject.robot.arm.track.at(subject.t)[1])


def test_a_runtime_error_ends_the_program_and_is_told(subject: Stepped) -> None:
    subject.scripts.take("def go():\n  movej(p[5,0,0,0,0,0])\nend\n")
    subject.run(0.1)
    assert subject.robot.runtime.state == RuntimeState.STOPPED
    assert "inverse kinematics" in subject.events[-1][2]


@pytest.mark.parametrize("speed", ["0", "-1"])
def test_a_speed_that_is_not_positive_is_a_runtime_error(subject: Stepped, speed: str) -> None:
    subject.scripts.take(f"def go():\n  movej([0,0,0,0,0,0],v={speed})\nend\n")
    subject.run(0.1)
    assert "positive" in subject.events[-1][2]


def test_the_command_handshake_goes_ready_done_ready(controlled: Stepped) -> None:
    controlled.vector(HOME + np.array([0.1, 0, 0, 0, 0, 0]))
    controlled.register(d6=1.0, d7=2.0, i1=0, i0=1)
    controlled.run(4 * CYCLE)
    assert controlled.out(0) == 1  # blocking: nothing changes before the move is done
    controlled.until(lambda: controlled.out(0) == 2)
    assert controlled.q[0] == pytest.approx(0.1)
    controlled.run(10 * CYCLE)
    assert controlled.out(0) == 2  # the same command is not executed twice
    controlled.register(i0=0)
    controlled.run(2 * CYCLE)
    assert controlled.out(0) == 1


def test_the_progress_word_shows_running_operation_and_changes(controlled: Stepped) -> None:
    idle = int(controlled.out(2))
    controlled.vector(HOME + np.array([0.2, 0, 0, 0, 0, 0]))
    controlled.register(d6=1.0, d7=2.0, i1=1, i0=1)
    controlled.until(lambda: controlled.out(0) == 2)
    moving = int(controlled.out(2))
    assert moving >> 15 & 1 == 1
    assert moving & 0x7FFF == 0
    assert moving >> 24 == (idle >> 24) + 1
    controlled.register(i0=0)
    controlled.until(lambda: int(controlled.out(2)) >> 15 & 1 == 0)
    assert controlled.q[0] == pytest.approx(0.2)


def test_a_servo_target_is_reached_while_the_command_stands(controlled: Stepped) -> None:
    controlled.vector(HOME + 0.01)
    controlled.register(d8=0.002, i0=11)
    controlled.run(0.1)
    np.testing.assert_allclose(controlled.q, HOME + 0.01, atol=1e-9)
    assert controlled.out(0) == 1


def test_the_arm_stops_when_the_watched_input_comes_too_late(controlled: Stepped) -> None:
    controlled.register(d0=10.0, i0=35)
    controlled.until(lambda: controlled.out(0) == 2)
    controlled.register(i0=0)
    for _ in range(20):
        controlled.robot.inputs.write({"input_int_register_0": 0}, controlled.t)
        controlled.run(0.05)
    assert controlled.robot.runtime.active
    controlled.vector(HOME + 1.0)
    controlled.register(d6=0.5, d7=2.0, i1=1, i0=1)
    controlled.run(0.3)
    assert not controlled.robot.runtime.active
    assert not np.any(controlled.robot.arm.track.at(controlled.t)[1])


def test_a_script_that_asks_for_the_impossible_dies(controlled: Stepped) -> None:
    controlled.vector(np.array([9.0, 0, 0, 0, 0, 0]))
    controlled.register(i0=46)
    controlled.run(0.02)
    assert controlled.robot.runtime.state == RuntimeState.STOPPED
    assert controlled.events[-1][:2] == ("STOPPED", "rtde_control")


def test_a_foreign_program_runs_until_somebody_stops_it(subject: Stepped) -> None:
    subject.robot.start(Program("foreign", foreign_steps(), "foreign"))
    subject.run(1.0)
    assert subject.dashboard.answer("running") == "Program running: true"
    assert subject.dashboard.answer("stop") == "Stopped"
    assert subject.dashboard.answer("running") == "Program running: false"


def test_speed_in_the_base_is_what_the_tcp_gets(subject: Stepped) -> None:
    subject.robot.set_tcp([0.05, 0.0, 0.2, 0.3, 0.0, 0.0])
    for _ in range(200):
        subject.robot.arm.speed_linear([0.05, 0.0, -0.02, 0.0, 0.1, 0.0], 1.0)
        subject.run(CYCLE)
    # By difference of reported poses, not by the Jacobian that made the speed.
    now, before = (np.array(subject.robot.instant(subject.t + dt).tcp_pose6) for dt in (0.0, -CYCLE))
    np.testing.assert_allclose((now - before)[:3] / CYCLE, [0.05, 0.0, -0.02], atol=1e-4)
