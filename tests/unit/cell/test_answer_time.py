"""Waiting for an answer in a process that stands still now and then."""

import asyncio
import socket
import time

import pytest

from cell.answer_time import answer_within


def _stand_still(seconds: float) -> None:
    """As a stopped process: nothing of the loop runs."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        pass


async def _read(stand_still: bool, within_s: float) -> bytes:
    """One byte that waits in the kernel while this loop stands still for longer than the limit."""
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    loop = asyncio.get_running_loop()
    with ours, theirs:
        if stand_still:

            def stand() -> None:
                theirs.send(b"a")
                _stand_still(within_s + 0.4)

            loop.call_later(0.02, stand)
        async with answer_within(within_s):
            return await loop.sock_recv(ours, 1)


@pytest.mark.parametrize("within_s", [0.05, 0.3])
def test_an_answer_that_came_while_this_process_stood_still_is_taken(within_s: float) -> None:
    assert asyncio.run(_read(True, within_s)) == b"a"


def test_no_answer_is_a_timeout_about_when_it_should_be() -> None:
    begun = time.monotonic()
    with pytest.raises(TimeoutError):
        asyncio.run(_read(False, 0.25))
    assert 0.25 <= time.monotonic() - begun < 4.0, "and a machine that pauses gets 5 s at most"


def test_a_loop_that_stands_still_again_and_again_is_forgiven_so_much_and_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cell.answer_time.MOST_LOST_S", 0.5)
    looks = 0

    async def main() -> None:
        nonlocal looks
        async with answer_within(0.1):
            for _ in range(20):
                looks += 1
                _stand_still(0.25)
                await asyncio.sleep(0.0)
                await asyncio.sleep(0.0)

    with pytest.raises(TimeoutError):
        asyncio.run(main())
    assert 2 <= looks < 20
