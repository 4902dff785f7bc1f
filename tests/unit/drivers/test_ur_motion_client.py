"""The daemon's side of the motion child, with a process that only waits and a thread that answers."""

import asyncio
import socket
import subprocess
import threading
import time

from cell.clock import MonotonicClock
from drivers.ur.framing import Unframer, encode
from drivers.ur.motion_client import MotionClient


def _answer_one_call(pipe: socket.socket) -> None:
    unframer = Unframer()
    while data := pipe.recv(65536):
        for message in unframer.feed(data):
            if "do" in message:
                pipe.sendall(encode({"id": message["id"], "ok": True, "value": "done"}))
                return


def test_a_child_whose_answer_came_while_the_daemon_stood_still_is_not_killed() -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    child = subprocess.Popen(["sleep", "60"], stdout=subprocess.PIPE)
    answering = threading.Thread(target=_answer_one_call, args=(theirs,), daemon=True)

    def stand_still() -> None:
        until = time.monotonic() + 0.8  # beyond the call's deadline and the grace
        while time.monotonic() < until:
            pass

    async def main() -> object:
        client = MotionClient(MonotonicClock(), child, ours)
        answering.start()
        asyncio.get_running_loop().call_soon(asyncio.get_running_loop().call_soon, stand_still)
        try:
            return await client.call("any", 0.1)
        finally:
            await client.finish(0.0)

    with ours, theirs:
        assert asyncio.run(main()) == "done"
    child.wait()
