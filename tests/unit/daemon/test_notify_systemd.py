"""Word to systemd, judged by a socket that plays systemd."""

import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from daemon.notify import Notifier


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """A bound notify socket and what NOTIFY_SOCKET says about it."""
    said = str(tmp_path / "notify") if request.param == "path" else f"@cellward-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as bound:
        bound.bind("\0" + said[1:] if said.startswith("@") else said)
        bound.settimeout(2.0)
        yield bound, said


@pytest.fixture
def subject(systemd: tuple[socket.socket, str]) -> Iterator[Notifier]:
    notifier = Notifier({"NOTIFY_SOCKET": systemd[1]})
    yield notifier
    notifier.close()


def test_each_word_arrives_as_systemd_defines_it(
    systemd: tuple[socket.socket, str], subject: Notifier
) -> None:
    subject.ready("waiting for\nthe arm")
    subject.status("run 7: capture")
    subject.watchdog()
    subject.stopping()
    got = [systemd[0].recv(4096).decode() for _ in range(4)]
    ready = "READY=1\nSTATUS=waiting for the arm"
    assert got == [ready, "STATUS=run 7: capture", "WATCHDOG=1", "STOPPING=1"]


def test_a_reader_that_does_not_read_never_blocks_us(
    systemd: tuple[socket.socket, str], subject: Notifier, caplog: pytest.LogCaptureFixture
) -> None:
    begun = time.monotonic()
    for _ in range(5000):
        subject.send("WATCHDOG=1")
    assert time.monotonic() - begun < 5.0
    assert 0 < subject.dropped < 5000
    assert len(caplog.records) == 1, "the loss is said once"


def test_a_reader_that_went_away_is_no_error(tmp_path: Path) -> None:
    subject = Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    subject.send("READY=1")
    assert subject.dropped == 1
    subject.close()


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "relative"}])
def test_without_systemd_nothing_is_sent(environment: dict[str, str]) -> None:
    subject = Notifier(environment)
    subject.ready()
    assert subject._socket is None
    assert subject.dropped == 0
    subject.close()


@pytest.mark.parametrize(
    ("environment", "seconds"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "5000000"}, 5.0),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": str(os.getpid())}, 5.0),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_time_is_ours_only_when_it_names_us(
    environment: dict[str, str], seconds: float | None
) -> None:
    assert Notifier(environment).watchdog_s == seconds
