"""The daemon at work on the twin: trigger to motion, loop lag, processor time and memory of each process.

Peers in the same run: the bare ur-rtde client for the time from a command to motion, and a bare asyncio
program with the same timer for the loop's lag.
"""

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import psutil
from pyModbusTCP.client import ModbusClient

from bench._expected import expect
from tests.kit.wire_cell import WireCell, pause, shipped, wait_for, wire_cell

BIND = "127.0.0.90"
TRIGGERS = 5
LAG_SECONDS = 20.0
START, ABORT = 1, 3

_BARE_CLIENT = """
import sys, time
import rtde_control, rtde_receive
host, count = sys.argv[1], int(sys.argv[2])
control = rtde_control.RTDEControlInterface(host)
receive = rtde_receive.RTDEReceiveInterface(host)
q = receive.getActualQ()
for i in range(count):
    target = list(q)
    target[5] += 0.2 if i % 2 == 0 else 0.0
    begun = time.monotonic()
    control.moveJ(target, 0.8, 1.4, True)
    while max(abs(v) for v in receive.getActualQd()) < 0.002:
        time.sleep(0.0002)
    print(time.monotonic() - begun, flush=True)
    while max(abs(v) for v in receive.getActualQd()) >= 0.002 or control.getAsyncOperationProgress() >= 0:
        time.sleep(0.01)
control.stopScript()
import os
os._exit(0)
"""

_BARE_LOOP = """
import asyncio, sys, time
async def main():
    lags = []
    end = time.monotonic() + float(sys.argv[1])
    while time.monotonic() < end:
        due = time.monotonic() + 0.05
        await asyncio.sleep(0.05)
        lags.append(max(time.monotonic() - due, 0.0))
    lags.sort()
    print(lags[len(lags) // 2], lags[len(lags) * 99 // 100], lags[-1])
asyncio.run(main())
"""


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="cellward-bench-") as folder:
        bare = _bare_client()
        with wire_cell(Path(folder), BIND, shipped("hand_eye", placements=3, poses_per_placement=12)) as cell:
            peer = subprocess.Popen(
                [sys.executable, "-c", _BARE_LOOP, str(LAG_SECONDS)], stdout=subprocess.PIPE, text=True
            )
            idle = _usage(cell, 5.0)
            triggers = _triggers(cell)
            cell.start_job("cone-capture")
            wait_for(cell.moving, "motion", 20.0)
            busy = _usage(cell, 15.0)
            lag = cell.status()["loop_lag"]
            out, _ = peer.communicate(timeout=LAG_SECONDS + 30.0)
            cell.call("halt")
    _print_times(triggers, bare)
    print(f"\n{'loop lag, 50 ms timer':38}{'p50':>9}{'p99':>9}{'max':>9}   ms")
    print(f"{'daemon, last minute, capture running':38}" + _ms(list(lag.values())))
    print(f"{'bare asyncio loop beside it':38}" + _ms([float(v) for v in out.split()]))
    _print_usage(idle, busy)


def _bare_client() -> list[float]:
    """Command to motion with ur-rtde alone, the client already connected; s."""
    from fakes.ur.process import running_controller

    with running_controller(BIND):
        done = subprocess.run(
            [sys.executable, "-c", _BARE_CLIENT, BIND, str(TRIGGERS)],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
    return [float(line) for line in done.stdout.split()]


def _triggers(cell: WireCell) -> list[float]:
    """Modbus start command to true motion of the arm; the plan and the motion client are in it; s."""
    plc = ModbusClient(host=BIND, port=5020, auto_open=True)
    times = []
    sequence = plc.read_input_registers(1, 1)[0]
    for _ in range(TRIGGERS):
        sequence = sequence % 65535 + 1
        begun = time.monotonic()
        plc.write_multiple_registers(0, [START, sequence, 1])
        wait_for(cell.moving, "motion", 20.0)
        times.append(time.monotonic() - begun)
        sequence = sequence % 65535 + 1
        plc.write_multiple_registers(0, [ABORT, sequence, 0])
        wait_for(lambda: cell.status()["job"] is None, "end of the run", 20.0)
        pause(0.5)
    plc.close()
    return times


def _usage(cell: WireCell, seconds: float) -> dict[str, tuple[float, float]]:
    """Per process of the daemon: percent of one core over ``seconds``, and resident MiB."""
    root = psutil.Process(expect(subprocess.Popen, cell.daemon).pid)
    processes = {_name(p, root): p for p in [root, *root.children(recursive=True)]}
    for process in processes.values():
        process.cpu_percent()
    pause(seconds)
    usage = {}
    for name, process in processes.items():
        if process.is_running():
            usage[name] = (process.cpu_percent(), process.memory_info().rss / 2**20)
    return usage


def _name(process: psutil.Process, root: psutil.Process) -> str:
    words = " ".join(process.cmdline())
    if process.pid == root.pid:
        return "daemon"
    for module, name in (("vision_child", "vision child"), ("motion_child", "arm motion child")):
        if module in words:
            return name
    return "worker's resource tracker" if "resource_tracker" in words else "solver worker"


def _print_times(triggers: Sequence[float], bare: Sequence[float]) -> None:
    print(f"{'command to motion':38}{'median':>9}{'max':>9}{'n':>5}   ms")
    for name, times in (
        ("PLC over Modbus: check, see, plan, move", triggers),
        ("bare ur-rtde moveJ, already connected", bare),
    ):
        if times:
            print(f"{name:38}{1e3 * statistics.median(times):9.1f}{1e3 * max(times):9.1f}{len(times):5}")


def _print_usage(idle: dict[str, tuple[float, float]], busy: dict[str, tuple[float, float]]) -> None:
    print(f"\n{'process':22}{'CPU idle':>10}{'CPU capture':>13}{'memory':>10}   % of a core, MiB resident")
    for name in sorted({*idle, *busy}):
        rest = f"{idle[name][0]:9.1f}%" if name in idle else f"{'-':>10}"
        work = f"{busy[name][0]:12.1f}%" if name in busy else f"{'-':>13}"
        memory = (busy.get(name) or idle[name])[1]
        print(f"{name:22}{rest}{work}{memory:10.0f}")
    total = sum(c for c, _ in busy.values()), sum(m for _, m in busy.values())
    print(f"{'together':22}{'':10}{total[0]:12.1f}%{total[1]:10.0f}")


def _ms(seconds: Sequence[float]) -> str:
    return "".join(f"{1e3 * v:9.2f}" for v in seconds)


if __name__ == "__main__":
    main()
