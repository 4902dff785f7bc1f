"""The motion child's rules, with a control interface that only notes what it is asked."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from drivers.ur import motion_child
from drivers.ur.framing import Message, Unframer, encode
from drivers.ur.motion_child import CallLimit, MotionChild
from drivers.ur.pace import SENT_AT

pytestmark = pytest.mark.wire  # the child's limits are in real time
_OPEN = {"host": "h", "watchdog_hz": 10.0}


class NotingControl:
    """Answers like a healthy client and remembers every call."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self.connected = True
        self.refuse: set[str] = set()
        self.slow_s = self.slow_kick_s = 0.0

    def isConnected(self) -> bool:
        return self.connected

    def getTCPOffset(self) -> list[float]:
        return [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]

    def __getattr__(self, name: str) -> Callable[..., bool]:
        def noted(*args: Any, **kwargs: Any) -> bool:
            self.calls.append((name, (*args, *kwargs.values())))
            if name == "setWatchdog":
                time.sleep(self.slow_s)
            if name == "kickWatchdog":
                time.sleep(self.slow_kick_s)
            return name not in self.refuse

        return noted

    def count(self, name: str) -> int:
        return sum(1 for called, _ in self.calls if called == name)


class Daemon:
    """The other end of the pipe."""

    def __init__(self) -> None:
        self.pipe, theirs = socket.socketpair()
        self.pipe.settimeout(2.0)
        self.control = NotingControl()
        self.exits: list[int] = []
        self._unframer = Unframer()
        self.unread: list[Message] = []
        child = MotionChild(theirs, lambda host: self.control, CallLimit(), leave=self._leave)
        self._thread = threading.Thread(target=self._run, args=(child, theirs), daemon=True)
        self._thread.start()

    def _leave(self, code: int) -> None:
        self.exits.append(code)
        raise SystemExit(code)

    def _run(self, child: MotionChild, theirs: socket.socket) -> None:
        with theirs, contextlib.suppress(SystemExit):
            child.run()

    def beat(self, age: float = 0.0) -> None:
        self.pipe.sendall(encode({"beat": time.monotonic() - age}))

    def ask(self, do: str, **arguments: Any) -> Message:
        self.pipe.sendall(encode({"id": 7, "do": do, "deadline_s": 0.5, "with": arguments}))
        return self.next(lambda m: m.get("id") == 7)

    def next(self, wanted: Callable[[Message], bool]) -> Message:
        while True:
            for message in self.unread:
                if wanted(message):
                    self.unread.remove(message)
                    return message
            self.unread += self._unframer.feed(self.pipe.recv(65536))

    def beating(self, seconds: float) -> float:
        """Beat for so long; returns the longest time between two beats, as a PC that pauses makes it."""
        last = time.monotonic()
        end, longest = last + seconds, 0.0
        while last < end:
            self.beat()
            time.sleep(0.01)
            now = time.monotonic()
            last, longest = now, max(longest, now - last)
        return longest

    def open(self) -> None:
        assert self.ask("open", **_OPEN)["ok"]

    def ended(self) -> list[int]:
        self._thread.join(2.0)
        assert not self._thread.is_alive()
        return self.exits

    def close(self) -> None:
        self.pipe.close()
        self._thread.join(2.0)


@pytest.fixture
def subject() -> Iterator[Daemon]:
    daemon = Daemon()
    yield daemon
    daemon.close()


def test_the_watchdog_is_set_right_after_the_upload(subject: Daemon) -> None:
    subject.open()
    names = [name for name, _ in subject.control.calls]
    assert names[:2] == ["isProgramRunning", "setWatchdog"]


def test_an_interface_whose_watchdog_cannot_be_set_is_not_used(subject: Daemon) -> None:
    subject.control.refuse.add("setWatchdog")
    reply = subject.ask("open", **_OPEN)
    assert not reply["ok"]
    assert "setWatchdog" in reply["text"]


def test_kicks_follow_the_beat_and_are_withheld_without_it(subject: Daemon) -> None:
    subject.beat()
    subject.open()
    subject.beating(0.2)
    assert subject.control.count("kickWatchdog") >= 3
    event = subject.next(lambda m: m.get("event") == "withheld")
    assert event["age_s"] > motion_child.BEAT_LIMIT_S
    kicks = subject.control.count("kickWatchdog")
    time.sleep(0.1)
    assert subject.control.count("kickWatchdog") == kicks
    subject.beat()
    subject.next(lambda m: m.get("event") == "kicking")


def test_beats_that_came_during_a_long_call_count(subject: Daemon) -> None:
    subject.beat()
    subject.control.slow_s = 0.2
    subject.pipe.sendall(encode({"id": 7, "do": "open", "deadline_s": 1.0, "with": _OPEN}))
    subject.beating(0.3)
    assert subject.next(lambda m: m.get("event") != "kicked")["id"] == 7
    assert subject.control.count("kickWatchdog") > 0
    subject.ask("stop", decel=1.0)
    assert not [m for m in subject.unread if m.get("event") == "withheld"]


def test_an_old_beat_that_was_stuck_in_the_pipe_is_no_beat(subject: Daemon) -> None:
    subject.open()
    subject.beat(age=0.5)
    subject.next(lambda m: m.get("event") == "withheld")
    assert subject.control.count("kickWatchdog") == 0


def test_every_kick_is_told_and_none_while_they_are_withheld(subject: Daemon) -> None:
    subject.beat()
    subject.open()
    subject.beating(0.2)
    subject.next(lambda m: m.get("event") == "withheld")
    since = time.monotonic()
    time.sleep(0.1)
    subject.ask("stop", decel=1.0)
    told = [m["at"] for m in subject.unread if m.get("event") == "kicked"]
    assert len(told) - 1 == subject.control.count("kickWatchdog"), "one is for the upload"
    assert told == sorted(told)
    assert told[-1] < since


def test_a_kick_is_told_before_the_native_call_that_may_never_return(subject: Daemon) -> None:
    subject.beat()
    subject.open()
    upload = subject.next(lambda m: m.get("event") == "kicked")["at"]
    subject.control.slow_kick_s = 0.15
    subject.pipe.sendall(encode({"beat": time.monotonic()}))
    told = subject.next(lambda m: m.get("event") == "kicked" and m["at"] > upload)
    assert time.monotonic() - told["at"] < 0.15


def test_set_points_are_told_as_kicks(subject: Daemon) -> None:
    subject.open()
    subject.beat()
    subject.ask("follow", horizon_s=0.1, ramp=8.0, lookahead=0.03, gain=500.0, decel=5.0)
    t0 = time.monotonic()
    subject.ask("piece", t0=t0, t1=t0 + 0.2, coefficients=[[0.5] * 6])
    subject.beating(0.2)
    subject.ask("stop", decel=1.0)
    told = [m["at"] for m in subject.unread if m.get("event") == "kicked" and m["at"] > t0]
    assert len(told) >= 3
    assert len(told) < subject.control.count("servoJ"), "not each of the 500 a second"


def test_kicking_ends_when_the_script_is_gone(subject: Daemon) -> None:
    subject.open()
    subject.control.refuse.add("kickWatchdog")
    subject.beating(0.2)
    assert subject.control.count("kickWatchdog") == 1


def test_late_beats_after_the_script_is_gone_are_not_told_as_withheld_kicks(subject: Daemon) -> None:
    subject.open()
    subject.control.refuse.add("kickWatchdog")
    subject.beating(0.1)
    assert subject.control.count("kickWatchdog") == 1
    time.sleep(motion_child.BEAT_LIMIT_S + 0.1)
    subject.beat()
    subject.ask("stop", decel=1.0)
    # Before the upload's first kick the beats may have been late; after the refused one they no longer count.
    kicked = [k for k, m in enumerate(subject.unread) if m.get("event") == "kicked"]
    assert not [m for m in subject.unread[kicked[-1] :] if m.get("event") == "withheld"]


def test_a_closed_pipe_ends_the_process(subject: Daemon) -> None:
    subject.open()
    subject.pipe.close()
    assert subject.ended() == [motion_child.EXIT_PIPE_CLOSED]


def test_a_dropped_link_ends_the_process_before_the_client_reconnects(subject: Daemon) -> None:
    subject.open()
    subject.control.connected = False
    assert subject.ended() == [motion_child.EXIT_LINK_LOST]


def test_moves_are_always_asynchronous(subject: Daemon) -> None:
    subject.open()
    assert subject.ask("move_joints", q=[0.1] * 6, speed=0.5, accel=1.0)["value"] is True
    assert subject.ask("move_linear", pose=[0.2] * 6, speed=0.1, accel=0.5)["value"] is True
    assert ("moveJ", ([0.1] * 6, 0.5, 1.0, True)) in subject.control.calls
    assert ("moveL", ([0.2] * 6, 0.1, 0.5, True)) in subject.control.calls


@pytest.mark.parametrize("q", [[0.1] * 5, [0.1] * 7, []])
def test_a_vector_of_another_length_never_reaches_the_client(subject: Daemon, q: list[float]) -> None:
    subject.open()
    reply = subject.ask("move_joints", q=q, speed=0.5, accel=1.0)
    assert not reply["ok"]
    assert subject.control.count("moveJ") == 0


def test_a_command_before_open_is_refused(subject: Daemon) -> None:
    assert not subject.ask("stop", decel=1.0)["ok"]


def follow_to_the_end(
    subject: Daemon, seconds: float, speed: float = 0.0, after_cycle_s: float = 0.0
) -> float:
    """Follow a piece of this ``speed``, which begins so long after a cycle of the controller, to its end, and
    again where this machine paused for longer than a beat may be late; returns when that following began."""
    for _ in range(10):
        subject.control.calls.clear()
        began = time.monotonic()
        subject.beat()
        assert subject.ask("follow", horizon_s=0.1, ramp=8.0, lookahead=0.03, gain=500.0, decel=5.0)["ok"]
        assert not subject.ask("move_joints", q=[0.1] * 6, speed=0.5, accel=1.0)["ok"]
        t0 = time.monotonic() + 0.02
        rows = [[0.5] * 6, [speed] * 6]
        how = {"t0": t0, "t1": t0 + seconds, "coefficients": rows, "cycle": t0 - after_cycle_s}
        piece = subject.ask("piece", **how)
        subject.ask("finish")
        subject.beating(seconds + 0.2)
        if subject.next(lambda m: m.get("event") == "followed")["end"] == "done":
            assert piece["value"]
            return began
    pytest.fail("the following was never taken to its end")


def test_set_points_follow_the_polynomial_until_the_end(subject: Daemon) -> None:
    subject.open()
    follow_to_the_end(subject, 0.1)
    sent = [args for name, args in subject.control.calls if name == "servoJ"]
    assert len(sent) > 20
    assert all(args[0] == [0.5] * 6 for args in sent)
    assert subject.control.calls[-1][0] in ("servoStop", "kickWatchdog")
    assert subject.control.count("servoStop") == 1


def test_set_points_are_for_instants_in_step_with_the_controllers_cycles(subject: Daemon) -> None:
    subject.open()
    follow_to_the_end(subject, 0.2, speed=1.0, after_cycle_s=0.0123)  # joints that tell the instant
    instants = np.array([args[0][0] for name, args in subject.control.calls if name == "servoJ"]) - 0.5
    followed = instants[(instants > 0.004) & (instants < 0.19)]
    assert len(followed) > 2
    into = (followed + 0.0123) / motion_child.SERVO_PERIOD_S - SENT_AT
    assert into == pytest.approx(np.round(into), abs=1e-4)


def test_an_older_controller_gets_a_set_point_in_each_of_its_own_cycles(subject: Daemon) -> None:
    """125 Hz of a CB3; a busy machine sends fewer, never more."""
    assert subject.ask("open", **_OPEN, servo_period_s=0.008)["ok"]
    began = follow_to_the_end(subject, 0.2)
    took = time.monotonic() - began
    sent = [args for name, args in subject.control.calls if name == "servoJ"]
    assert sent
    assert len(sent) <= took / 0.008 + 2
    assert {args[3] for args in sent} == {0.008}


def test_following_ends_by_itself_when_the_beat_stops(subject: Daemon) -> None:
    subject.open()
    subject.beat()
    subject.ask("follow", horizon_s=5.0, ramp=8.0, lookahead=0.03, gain=500.0, decel=5.0)
    t0 = time.monotonic()
    subject.ask("piece", t0=t0, t1=t0 + 60.0, coefficients=[[0.0] * 6, [0.4] * 6])
    assert subject.next(lambda m: m.get("event") == "followed")["end"] == "not renewed"
    last = [args[0][0] for name, args in subject.control.calls if name == "servoJ"][-1]
    # The horizon that the daemon asks for cannot exceed the limit of the beat.
    assert last < 0.4 * (motion_child.BEAT_LIMIT_S + 0.1) + 0.4**2 / 16.0


def test_the_end_stops_the_script_and_the_process(subject: Daemon) -> None:
    subject.open()
    assert subject.ask("end")["ok"]
    assert subject.ended() == [motion_child.EXIT_PIPE_CLOSED]
    assert subject.control.count("stopScript") == 1
