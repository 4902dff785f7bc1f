"""What a recording of the wire costs: the same packages of an arm with and without it, in one run.

Packages of 330 bytes go through a socket pair into the driver's link (``RtdeLink.drain``), which is what
the daemon does 500 times a second. Rounds with and without a recording take turns; the CPU time is that of
the whole process, so the thread that writes is in it.

    python -m bench.recording [PACKAGES]
"""

import asyncio
import socket
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.wire_recording.tap import recorded_by, tap
from cell.wire_recording.writer import WireRecorder
from drivers.ur.rtde import PackageType, encode
from drivers.ur.rtde_link import RtdeLink

PACKAGE = encode(PackageType.DATA, bytes(327))
ROUNDS = 7
RATE_HZ = {"arm (RTDE)": 500, "input module, question and answer": 1000, "belt encoder": 200, "camera": 10}


async def drained(packages: int) -> float:
    """CPU seconds of the process for each package that is sent, received and split."""
    theirs, ours = socket.socketpair()
    ours.setblocking(False)
    seen = 0

    def take(payload: bytes, arrival: float) -> None:
        nonlocal seen
        seen += 1

    def lost(failure: CellError) -> None:
        raise failure

    link = RtdeLink("127.0.0.1", ours, MonotonicClock(), lost)
    link._on_data = take  # noqa: SLF001
    begun = time.process_time()
    for _ in range(packages):
        theirs.send(PACKAGE)
        link.drain()
    spent = time.process_time() - begun
    link.close()
    theirs.close()
    if seen != packages:
        raise SystemExit(f"{seen} of {packages} packages came through the link")
    return spent / packages


def main() -> None:
    packages = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    cpu: dict[bool, list[float]] = {False: [], True: []}
    stall: dict[bool, list[float]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as name:
        for number in range(ROUNDS):
            for recording in (False, True):
                with ExitStack() as stack:
                    if recording:
                        recorder = WireRecorder(Path(name) / str(number), 10**9)
                        stack.enter_context(recorded_by(recorder))
                    cpu[recording].append(asyncio.run(drained(packages)))
                    stall[recording] += single_calls(packages)
                    if recording:
                        recorder.close()
        written = sum(path.stat().st_size for path in Path(name).rglob("wire-*.bin")) / ROUNDS
    without, with_it = (1e6 * statistics.median(cpu[on]) for on in (False, True))
    more = with_it - without
    print(f"{packages} packages of {len(PACKAGE)} bytes, {ROUNDS} rounds each, median; CPU of the process")
    print(f"{'':34}{'us for a package':>18}")
    print(f"{'without a recording':34}{without:18.2f}")
    print(f"{'with a recording':34}{with_it:18.2f}")
    print(f"{'what it costs':34}{more:18.2f}")
    calls = sum(RATE_HZ.values())
    print(f"\na cell with {', '.join(f'{what} {hz}/s' for what, hz in RATE_HZ.items())}:")
    print(f"  {calls} records/s, {1e-4 * more * calls:.2f} % of a core")
    print(f"\n{'one call of a tap, us (wall clock)':34}{'half':>9}{'99.9 %':>9}{'longest':>9}")
    for name, took in (
        ("without a recording", sorted(stall[False])),
        ("with a recording", sorted(stall[True])),
    ):
        shown = (took[len(took) // 2], took[int(0.999 * len(took))], took[-1])
        print(f"{name:34}{''.join(f'{1e6 * one:9.1f}' for one in shown)}")
    print("(the calls come without a pause, hundreds of times faster than those of a cell)")
    print(f"on the disk: {written / packages / 2:.0f} bytes a package, {len(PACKAGE)} of them its own")


def single_calls(count: int) -> list[float]:
    """How long each of ``count`` calls takes, s; the disk is written meanwhile."""
    told = tap("rtde", "127.0.0.1:30004")
    took = []
    for _ in range(count):
        begun = time.perf_counter()
        told.received(PACKAGE)
        took.append(time.perf_counter() - begun)
    return took


if __name__ == "__main__":
    main()
