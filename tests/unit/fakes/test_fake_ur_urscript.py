"""URScript on the fake controller: what is understood is run, what is not ends the program with an error."""

import logging

import numpy as np
import pytest

from fakes.ur.runtime import RuntimeState
from fakes.ur.urscript import Do, If, While, read_program
from tests.kit.fake_ur_stepped import HOME, Stepped


@pytest.fixture
def subject() -> Stepped:
    return Stepped()


def result(subject: Stepped, body: str, register: int = 5) -> float:
    """Run ``body`` to its end and read an output register of whole numbers."""
    subject.scripts.take(program(body))
    subject.until(lambda: bool(subject.events) and subject.events[-1][0] == "STOPPED")
    assert subject.events[-1][2] == "", subject.events
    return subject.out(register)


def program(body: str) -> str:
    return "def job():\n" + body.strip("\n") + "\nend\n"


def test_a_program_is_read_into_statements_with_their_lines() -> None:
    source = read_program(
        'def job():\n  # comment\n  textmsg("a # b") # more\n  while True:\n    sleep(0.1)\n  end\n'
        "  if x > 1:\n    sync()\n  else:\n    sync()\n  end\nend\n"
    )
    assert source.unknown is None
    assert (source.name, source.secondary) == ("job", False)
    assert [(type(s), s.line) for s in source.statements] == [(Do, 3), (While, 4), (If, 7)]


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("thread t():\n  sync()\nend", 2),
        ("if True:\n  sync()", 2),
        ("sync()\nend", 3),
        ("else:\n  sync()\nend", 2),
        ("movej([1,", 2),
        ("x, y = 1, 2", 2),
        ("if True:\n  def f():\n  end\nend", 3),
    ],
)
def test_what_is_outside_the_subset_is_named_by_its_line(body: str, line: int) -> None:
    source = read_program(f"def odd():\n{body}\nend\n")
    assert source.unknown is not None
    assert source.unknown[0] == line


@pytest.mark.parametrize(
    ("body", "value"),
    [
        ("x = 3\nwrite_output_integer_register(5, x * 2 + 1)", 7),
        ("x = 3\nif x < 2:\n  y = 1\nelif x == 3:\n  y = 2\nelse:\n  y = 3\nend\n"
         "write_output_integer_register(5, y)", 2),
        ("i = 0\nwhile i < 10:\n  i = i + 1\n  if i == 4:\n    break\n  end\nend\n"
         "write_output_integer_register(5, i)", 4),
        ("i = 0\nn = 0\nwhile i < 5:\n  i = i + 1\n  if i == 2:\n    continue\n  end\n  n = n + 1\nend\n"
         "write_output_integer_register(5, n)", 4),
        ("def twice(a, b=1):\n  return a * 2\nend\n", None),
        ("def twice(a):\n  return a * 2\nend\nwrite_output_integer_register(5, twice(twice(3)))", 12),
        ("q = [1, 2, 3]\nr = q\nr[1] = 20\nwrite_output_integer_register(5, q[1] + r[1])", 22),
        ("t = p[1,2,3,0,0,0]\nt[2] = 7\nwrite_output_integer_register(5, t[2])", 7),
        ("if not False and (1 == 2 or 2 >= 2):\n  write_output_integer_register(5, 1)\nend", 1),
        ("write_output_integer_register(5, floor(sqrt(17)) + length([1, 2]) + 7 % 4)", 9),
        ("global g = 1\ndef f():\n  g = g + 4\nend\nf()\nwrite_output_integer_register(5, g)", 5),
        ("def f():\n  local h = 1\n  halt\nend\nwrite_output_integer_register(5, 3)\nf()\n"
         "write_output_integer_register(5, 4)", 3),
    ],
)  # fmt: skip
def test_a_program_computes(subject: Stepped, body: str, value: float | None) -> None:
    if value is None:
        assert read_program(program(body)).unknown is not None  # default values are not in the subset
    else:
        assert result(subject, body) == value


def test_a_function_with_a_condition_moves_the_arm(subject: Stepped) -> None:
    body = """
  q = get_actual_joint_positions()
  if q[0] < 0.5:
    q[0] = q[0] + 0.2
    movej(q, a=6, v=2)
  end
  here = get_actual_tcp_pose()
  movel(pose_trans(here, p[0, 0, 0.01, 0, 0, 0]), v=0.1)
  write_output_integer_register(5, 2)
"""
    assert result(subject, body) == 2
    assert subject.q[0] == pytest.approx(HOME[0] + 0.2, abs=0.02)


def test_the_line_that_runs_is_told(subject: Stepped) -> None:
    subject.scripts.take(program("x = 1\nsleep(1.0)\nsleep(1.0)"))
    subject.run(0.5)
    assert subject.robot.script_line == 3
    subject.run(1.0)
    assert subject.robot.script_line == 4
    subject.run(1.0)
    assert subject.robot.script_line == 0


@pytest.mark.parametrize(
    ("body", "line", "text"),
    [
        ("  calldoesntexist()", 2, "compile_error_name_not_found:calldoesntexist:"),
        ("  x = 1\n  sleep(y)", 3, "compile_error_name_not_found:y:"),
        ("  socket_open(\"127.0.0.1\", 5)", 2, "compile_error_name_not_found:socket_open:"),
        ("  thread t():\n  end", 2, "the twin does not interpret this program: threads are not known"),
    ],
)  # fmt: skip
def test_a_program_with_what_is_unknown_is_not_started_and_ends_the_one_that_runs(
    subject: Stepped, body: str, line: int, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    failures = []
    subject.robot.on_program.append(lambda event, name, failure: failures.append((event, name, failure)))
    subject.scripts.take(program("while True:\n  sync()\nend"))
    subject.until(lambda: subject.robot.runtime.state == RuntimeState.PLAYING)
    subject.scripts.take(program(body))
    subject.run(0.1)
    assert not subject.robot.runtime.active
    event, name, failure = failures[-1]
    assert (event, name) == ("EXCEPTION", "job")
    assert failure is not None
    assert (failure.line, failure.text) == (line, text)
    assert text in caplog.text
    assert caplog.records[-1].levelno == logging.WARNING


def test_an_unknown_name_is_told_with_its_column(subject: Stepped) -> None:
    failures = []
    subject.robot.on_program.append(lambda event, name, failure: failures.append(failure))
    subject.scripts.take("def illegal_fun():\n  calldoesntexist()\nend\n")
    assert failures[0] is not None
    assert (failures[0].line, failures[0].column) == (2, 3)
    assert subject.messages == ["the twin does not know calldoesntexist, which a controller may"]


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("x = 1 / 0", "division by zero"),
        ("if 1:\n  sync()\nend", "a condition must be True or False"),
        ("x = [1, 2]\ny = x[2]", "there is no item 2 of 2"),
        ("movej([0, 0, 0], v=1)", "needs a pose or six joint angles"),
        ("movej([0,-1.8,1.8,-1.57,-1.57,0], v=-1)", "positive"),
        ("movej([0,-1.8,1.8,-1.57,-1.57,0], t=3)", "not in a given time"),
        ("sleep()", "missing a required argument"),
        ("x = acos(3)", "acos:"),
        ("def f(a):\n  return f(a)\nend\nx = f(1)", "too many calls"),
        ("x = 2 ** 3", "+ - * / and % only"),
        ("write_output_integer_register(99, 1)", "not between 0 and 47"),
        ("x = 3\nwhile True:\n  x = x * x\nend", "32 bits"),
        ("x = [1]\nwhile True:\n  x = [x, x]\nend", "more than 1000 items"),
        ('x = "ab"\nwhile True:\n  x = str_cat(x, x)\nend', "more than 1000 items or letters"),
    ],
)
def test_an_error_at_run_time_ends_the_program_and_says_why(subject: Stepped, body: str, text: str) -> None:
    subject.scripts.take(program(body))
    subject.until(lambda: bool(subject.events) and subject.events[-1][0] == "STOPPED", 0.2)
    assert text in subject.events[-1][2]


def test_an_endless_loop_without_waiting_does_not_stop_the_clock(subject: Stepped) -> None:
    subject.scripts.take(program("i = 0\nwhile True:\n  i = i + 1\nend"))
    subject.run(0.1)
    assert subject.robot.runtime.state == RuntimeState.PLAYING
    assert subject.dashboard.answer("stop") == "Stopped"


def test_protective_stop_from_a_program_and_from_a_single_line(subject: Stepped) -> None:
    for text in (program("protective_stop()"), "protective_stop()\n"):
        subject.scripts.take(text)
        subject.until(lambda: subject.dashboard.answer("safetymode") == "Safetymode: PROTECTIVE_STOP", 1.0)
        assert subject.dashboard.answer("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
        subject.run(5.1)
        assert subject.dashboard.answer("unlock protective stop") == "Protective stop releasing"
        assert subject.dashboard.answer("stop") == "Stopped"


def test_force_mode_in_a_program_moves_and_ends_with_it(subject: Stepped) -> None:
    before = subject.tcp
    body = (
        "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-10,0,0,0], 2, [1,1,1,1,1,1])\n"
        "sleep(0.5)\nend_force_mode()\nstopl(5)\nwrite_output_integer_register(5, 1)"
    )
    assert result(subject, body) == 1
    assert before[2] - subject.tcp[2] > 0.005
    np.testing.assert_allclose(subject.tcp[:2], before[:2], atol=1e-5)
    assert subject.robot.modes.mode.name == "POSITION"


@pytest.mark.parametrize(
    "line", ['textmsg("ExternalControl: steptime=", 1)', 'socket_open("127.0.0.1", 50001, "reverse_socket")']
)
def test_the_program_of_urs_driver_is_refused_by_name(
    subject: Stepped, line: str, caplog: pytest.LogCaptureFixture
) -> None:
    subject.scripts.take(f"def externalControl():\n {line}\n thread s():\n end\nend\n")
    subject.run(0.1)
    assert not subject.robot.runtime.active
    assert "does not emulate UR's External Control program" in subject.events[-1][2]
    assert "External Control" in caplog.text
