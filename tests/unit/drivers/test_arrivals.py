"""Bytes are stamped when they arrive, however late they are taken."""

import os
import select
import time
import tty
from collections.abc import Iterator
from contextlib import suppress

import pytest

from drivers.can_bus.arrivals import Arrivals


@pytest.fixture
def line() -> Iterator[tuple[int, int]]:
    far, near = os.openpty()
    tty.setraw(near)
    os.set_blocking(near, False)
    yield far, near
    for fd in (far, near):
        with suppress(OSError):
            os.close(fd)


def heard(subject: Arrivals) -> float:
    """The time once there is something to take."""
    assert select.select([subject.fd], [], [], 10.0)[0]
    return time.monotonic()


def test_a_stamp_is_of_the_arrival_and_not_of_the_taking(line: tuple[int, int]) -> None:
    far, near = line
    subject = Arrivals(near)
    begun = time.monotonic()
    os.write(far, b"one\r")
    first = heard(subject)
    os.eventfd_read(subject.fd)
    os.write(far, b"two\r")
    second = heard(subject)
    (t1, one), (t2, two) = subject.take()
    subject.close()
    assert (one, two) == (b"one\r", b"two\r")
    assert begun <= t1 <= first <= t2 <= second


def test_what_came_before_the_line_went_is_not_lost(line: tuple[int, int]) -> None:
    far, near = line
    subject = Arrivals(near)
    os.write(far, b"last words\r")
    heard(subject)
    os.close(far)
    found = b""
    with pytest.raises(OSError, match=r"\w"):
        while heard(subject):
            found += b"".join(chunk for _, chunk in subject.take())
    subject.close()
    assert found == b"last words\r"


def test_closing_ends_the_thread_and_leaves_the_line_open(line: tuple[int, int]) -> None:
    _, near = line
    subject = Arrivals(near)
    subject.close()
    subject.close()
    assert not subject._thread.is_alive()
    os.fstat(near)
