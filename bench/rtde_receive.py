"""State packages received of those sent, ours beside ur-rtde's receiver, under 0, 2 and 4 busy processes.

Both clients subscribe to the same variables of one fake controller at 500 Hz, in one process each, at the
same time. "Sent" is what the controller's own stamps cover; a sample counts once. The last lines give what
one package costs our driver.
"""

import asyncio
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection

import numpy as np

from cell.clock import MonotonicClock
from cell.samples import Stream
from drivers.ur import UrArm
from drivers.ur.feed import NAMES, StateFeed
from drivers.ur.rtde import PackageType as PackageKind
from drivers.ur.rtde import Recipe, Splitter, encode
from fakes.ur.process import running_controller

HOST = "127.0.0.38"
SECONDS = 5.0
FREQUENCY_HZ = 500.0
VARIABLES = ["timestamp", "actual_q", "actual_qd", "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force"]

_SPAWN = multiprocessing.get_context("spawn")


def ours() -> list[float]:
    """The controller stamps that reach our driver in the measured time."""

    async def listen() -> list[float]:
        arm = UrArm("arm", UrArm.Config(host=HOST, lost_after_s=2.0), MonotonicClock())
        await arm.open()
        stamps: list[float] = []
        arm.state.subscribe(lambda sample: stamps.append(sample.value.stamp))
        await asyncio.sleep(SECONDS)
        await arm.close()
        return stamps

    return asyncio.run(listen())


def genuine() -> list[float]:
    """The stamps that a reader of ur-rtde's receiver sees when it looks every 0.2 ms."""
    from rtde_receive import RTDEReceiveInterface

    receiver = RTDEReceiveInterface(HOST, FREQUENCY_HZ, VARIABLES)
    stamps: list[float] = []
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        stamp = receiver.getTimestamp()
        if not stamps or stamp != stamps[-1]:
            stamps.append(stamp)
        time.sleep(0.0002)
    receiver.disconnect()
    return stamps


CLIENTS: dict[str, Callable[[], list[float]]] = {"ours": ours, "ur-rtde": genuine}


def run_client(name: str, answer: "Connection[list[float], None]") -> None:
    answer.send(CLIENTS[name]())


def spin(stop_after: float) -> None:
    """A process that wants a whole core."""
    end = time.monotonic() + stop_after
    while time.monotonic() < end:
        sum(range(1000))


@contextmanager
def busy(count: int) -> Iterator[None]:
    hogs = [_SPAWN.Process(target=spin, args=(60.0,), daemon=True) for _ in range(count)]
    for hog in hogs:
        hog.start()
    time.sleep(0.5 if hogs else 0.0)
    try:
        yield
    finally:
        for hog in hogs:
            hog.terminate()
            hog.join()


def measure() -> dict[str, list[float]]:
    """Both clients at the same time, each in its own process."""
    running = {}
    for name in CLIENTS:
        mine, theirs = _SPAWN.Pipe(duplex=False)
        process = _SPAWN.Process(target=run_client, args=(name, theirs), daemon=True)
        process.start()
        theirs.close()
        running[name] = (process, mine)
    found = {}
    for name, (process, mine) in running.items():
        found[name] = mine.recv() if mine.poll(60.0) else []
        process.join()
        mine.close()
    return found


def row(load: int, name: str, stamps: list[float]) -> str:
    sent = round((stamps[-1] - stamps[0]) * FREQUENCY_HZ) + 1
    gap = float(np.max(np.diff(stamps))) * 1e3
    return f"{load:5d}  {name:8s} {len(stamps):9d} {sent:6d} {100 * len(stamps) / sent:7.1f} % {gap:10.1f} ms"


def cost_per_package(count: int = 5000) -> tuple[float, float]:
    """Median and 99th percentile, in microseconds, from bytes to a pushed sample."""
    clock = MonotonicClock()
    feed = StateFeed(Stream("arm", clock), clock, 0.0)
    words = {"robot_mode": "INT32", "safety_mode": "INT32", "safety_status_bits": "UINT32"}
    words |= {"runtime_state": "UINT32", "actual_digital_input_bits": "UINT64"}
    words |= {"actual_digital_output_bits": "UINT64", "timestamp": "DOUBLE", "payload": "DOUBLE"}
    words |= {"target_speed_fraction": "DOUBLE", "speed_scaling": "DOUBLE", "payload_cog": "VECTOR3D"}
    recipe = Recipe(1, NAMES, tuple(words.get(n, "VECTOR6D") for n in NAMES))
    feed.begin(recipe, FREQUENCY_HZ)
    rest = bytes(recipe.layout.size - 8)
    splitter, times = Splitter(), []
    for k in range(count):
        wire = encode(PackageKind.DATA, b"\x01" + np.array(k / FREQUENCY_HZ, ">f8").tobytes() + rest)
        begin = time.perf_counter()
        for package in splitter.feed(wire):
            feed.take(package.payload, clock.now())
        times.append((time.perf_counter() - begin) * 1e6)
    return float(np.median(times)), float(np.percentile(times, 99))


def main() -> int:
    print(f"RTDE state at {FREQUENCY_HZ:.0f} Hz for {SECONDS:.0f} s, both clients at once")
    print(" busy  client    received   sent   share   largest gap")
    with running_controller(HOST):
        for load in (0, 2, 4):
            with busy(load):
                for name, stamps in measure().items():
                    print(row(load, name, stamps), flush=True)
    median, high = cost_per_package()
    print(f"one package costs our driver {median:.0f} us (median), {high:.0f} us (99 %)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
