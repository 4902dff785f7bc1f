"""A cell whose devices are a recording: supervisor and engine on virtual time that runs like the recording's.

The recording is made on the wire: a twin and a daemon as processes. What people did then is done again at the
same times. Child processes are played at their pipes; a solver takes as long as it took.
"""

import asyncio
import bisect
import re
import shutil
import socket
import subprocess
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from cell.answer_time import answer_within
from cell.clock import Clock
from cell.motion import MotionBroker
from cell.poses import Array, from_pose6
from cell.store.journal import read_journal
from cell.store.ledger import Ledger
from cell.store.runs import JOURNAL_FILE, list_runs
from cell.wire_recording.reader import WireRecording, read_recording
from daemon.cell_context import CellContext
from daemon.composition import supervised_devices
from daemon.config import CellConfig, load_config
from daemon.engine import Engine
from daemon.health import Beats
from daemon.start_request import StartRequest
from daemon.supervisor import Supervisor
from daemon.worker import InlineWorker
from drivers.oak.link import ChildLink
from drivers.ur.motion_client import MotionClient
from fakes.object.loop import VirtualTimeLoop, run_virtual
from fakes.replay.dialects import BY_NUMBER, Cutter
from fakes.replay.player import WirePlayer
from fakes.world.toml_text import to_toml
from procedures.registry import JOBS
from tests.kit.object_cell import on_disk
from tests.kit.stream_instants import RecordedClock, first_counts, steps_of
from tests.kit.tracker_instants import asked_as_recorded
from tests.kit.wire_cell import WireCell, pause, wire_cell

WHO = "test"
PAUSE_S = 1.0  # the longest that a recorded program may have stood still
SOLVED_M, SOLVED_RAD = 3e-6, 1e-4  # by which a tool's frame may differ that is solved again
LEAD_S = 0.01  # by which virtual time begins before the recording


@dataclass
class Session:
    """What people did while it was recorded, with times (monotonic s), and what came of it."""

    folder: Path
    did: list[tuple[float, str, dict[str, Any]]] = field(default_factory=list)

    @property
    def state(self) -> Path:
        """The daemon's state folder."""
        return self.folder / "state"

    @property
    def recording(self) -> WireRecording:
        (folder,) = (self.state / "recordings").iterdir()
        return read_recording(folder)

    @property
    def before(self) -> Path:
        """The state folder as the daemon found it."""
        return self.folder / "before"

    @property
    def results(self) -> list[dict[str, Any]]:
        """Of the runs, oldest first; {} of one without a result."""
        return [run.read_result() or {} for run in list_runs(self.state / "runs")]

    @property
    def starts(self) -> list[float]:
        """When each run began, by its journal, monotonic s."""
        runs = list_runs(self.state / "runs")
        return [next(line["t"] for line in read_journal(run.path / JOURNAL_FILE)) for run in runs]

    @property
    def outcomes(self) -> list[str]:
        """How the runs ended."""
        ends = [run.read_end() for run in list_runs(self.state / "runs")]
        return ["no end" if end is None else end["outcome"] for end in ends]


def as_replayable(scenario: str) -> str:
    """An encoder behind its gateway. A run replays on virtual time, on which a serial line is not played."""
    if "[world.belt" not in scenario:
        return scenario
    kept = [line for line in scenario.splitlines() if not line.startswith("can =")]
    if "[fakes]" not in kept:
        kept.append("[fakes]")
    kept.insert(kept.index("[fakes]") + 1, 'can = "socketcand"')
    return "\n".join(kept) + "\n"


def record(
    folder: Path,
    bind: str,
    scenario: str,
    jobs: list[str],
    first: Callable[[WireCell], None] = lambda cell: None,
    finish_after_s: float | None = None,
) -> Session:
    """Run the jobs on the wire, one after the other, while every byte is recorded."""
    folder.mkdir(exist_ok=True)
    session = Session(folder)

    def prepare(cell: WireCell) -> None:
        first(cell)
        tables = cell.config()
        tables["cell"]["record"] = True
        (folder / "cell.toml").write_text(to_toml(tables), "utf-8")
        (folder / "state").mkdir(exist_ok=True, mode=0o700)
        shutil.copytree(folder / "state", session.before)

    def do(cell: WireCell, method: str, **params: Any) -> Any:
        session.did.append((time.monotonic(), method, params))
        return cell.call(method, **params)

    with wire_cell(folder, bind, scenario, prepare) as cell:
        for job in jobs:
            run_id = do(cell, "start", job=job)["run_id"]
            begun = time.monotonic()
            while (status := cell.status())["job"] is not None:
                if prompt := status["prompt"]:
                    if not prompt["text"].startswith("Placement 1 "):
                        cell.move_board()
                    do(cell, "confirm", prompt_id=prompt["id"])
                if finish_after_s is not None and time.monotonic() - begun > finish_after_s:
                    do(cell, "finish")
                    finish_after_s = None
                pause(0.05)
            if job != jobs[-1]:
                _accept_all(cell, run_id, do)
    return session


def _accept_all(cell: WireCell, run_id: int, do: Callable[..., Any]) -> None:
    ledger = Ledger(cell.folder / "state" / "ledger.sqlite", read_only=True)
    rows = ledger.results()
    ledger.close()
    for row in rows:
        if row["run_id"] == run_id and row["state"] == "proposed":
            do(cell, "accept", result_id=row["id"])


def replay(session: Session, folder: Path, limit_s: float = 3600.0) -> Session:
    """The same jobs again, with the drivers on the recording; what came of it is below ``folder``."""
    folder.mkdir(exist_ok=True)
    shutil.copytree(session.before, folder / "state")
    tables = tomllib.loads((session.folder / "cell.toml").read_text("utf-8"))
    tables["cell"] |= {
        "record": False,
        "state_dir": str(folder / "state"),
        "control_socket": str(folder / "s"),
    }
    for path in session.folder.glob("*.json"):
        shutil.copy(path, folder)
    path = folder / "cell.toml"
    path.write_text(to_toml(tables), "utf-8")
    path.chmod(0o600)
    config = load_config(path)
    recording = session.recording
    steps, counts = steps_of(session.state), first_counts(session.state)
    clock = RecordedClock(recording.begin - LEAD_S, steps[:, 0].tolist(), counts)
    run_virtual(_play(session, recording, config, clock), limit_s)
    return Session(folder)


async def _play(session: Session, recording: WireRecording, config: CellConfig, clock: RecordedClock) -> None:
    state = Path(config.cell.state_dir)
    runs = state / "runs"
    runs.mkdir(exist_ok=True)
    ledger = on_disk(Ledger, state / "ledger.sqlite")
    async with WirePlayer(recording, clock) as player:
        with ExitStack() as stack:
            stack.enter_context(_stand_ins(player, clock))
            stack.enter_context(clock.pacing())
            if recording.of("tracker"):
                stack.enter_context(asked_as_recorded(player, clock, session.state))
            supervisor = Supervisor(supervised_devices(config, clock, Beats(clock)))
            worker = RecordedPace(clock, session, recording)
            context = CellContext(config, clock, worker, supervisor, MotionBroker(clock), ledger)
            engine = Engine(context, JOBS, runs)
            tasks = [asyncio.create_task(e.run(), name=f"device {n}") for n, e in supervisor.devices.items()]
            try:
                await _do_again(session, engine, clock)
            finally:
                await engine.shutdown()
                for task in tasks:
                    task.cancel()
                await asyncio.wait(tasks)
    ledger.close()


async def _do_again(session: Session, engine: Engine, clock: Clock) -> None:
    """What people did, at the times at which they did it, but not before the cell asks for it."""
    starts = session.starts
    for t, method, params in session.did:
        if method == "start":
            t = starts.pop(0)
        await clock.sleep(max(t - clock.now(), 0.0))
        if method == "start":
            while engine.active:
                await clock.sleep(0.01)
            await engine.start(StartRequest(params["job"], {}, WHO, "test"))
        elif method == "confirm":
            while engine.active and engine.status()["prompt"] is None:
                await clock.sleep(0.01)
            if engine.active:
                await engine.confirm(engine.status()["prompt"]["id"], WHO)
        elif method == "finish":
            await engine.finish(WHO)
        elif method == "accept":
            while engine.active:
                await clock.sleep(0.01)
            await engine.decisions.accept(params["result_id"], WHO)
    while engine.active:
        await clock.sleep(0.05)


class RecordedPace(InlineWorker):
    """Computes at once, and is ready when it was: just before what was done next, by the job or by people."""

    def __init__(self, clock: Clock, session: Session, recording: WireRecording) -> None:
        self._clock = clock
        people = [t for t, _, _ in session.did]
        self._commands = sorted(
            people
            + [
                record.t
                for protocol in ("motion-child", "vision-child")
                for connection in recording.of(protocol)
                for record in connection.records
                if record.sent
                and any(
                    BY_NUMBER[protocol].asks(message) is not None
                    for message in Cutter(BY_NUMBER[protocol].length).feed(record.data)
                )
            ]
        )

    async def call(self, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        found = await super().call(fn, *args, **kwargs)
        now = self._clock.now()
        place = bisect.bisect_right(self._commands, now)
        if place < len(self._commands):
            await self._clock.sleep(max(self._commands[place] - now - 0.002, 0.0))
        return found


@contextmanager
def _stand_ins(player: WirePlayer, clock: Clock) -> Iterator[None]:
    """Children are played at their pipes; modules and an arm that is read are asked when they were asked."""

    class Motion(MotionClient):
        @classmethod
        def start(cls, clock: Clock) -> "Motion":
            ours, theirs = socket.socketpair()
            ours.setblocking(False)
            process = subprocess.Popen(["sleep", "3600"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
            client = cls(clock, process, ours)
            client.played = asyncio.create_task(player.pipe(theirs, "motion-child", "child"))  # type: ignore[attr-defined]
            return client

        async def finish(self, timeout: float) -> None:
            """The process that stands in has nothing to finish; time stands still until it has gone."""
            loop = asyncio.get_running_loop()
            assert isinstance(loop, VirtualTimeLoop)
            self._process.kill()
            with loop.outside():
                await self.ended.wait()
            await super().finish(timeout)

    class NoProcess:
        pid, returncode, stderr = 0, 0, None

        async def wait(self) -> int:
            return 0

        def kill(self) -> None: ...

    async def start(self: ChildLink, module: str) -> None:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        reader, self._writer = await asyncio.open_connection(sock=ours)
        await player.pipe(theirs, "vision-child", self.name)
        self._process = NoProcess()  # type: ignore[assignment]
        self._tasks = [asyncio.create_task(self._listen(reader, self._process))]  # type: ignore[arg-type]

    class Ticker:
        def __init__(self, period_s: float) -> None:
            self._period_s, self._number = period_s, 0

        def start(self) -> None:
            self._begun = clock.now()
            self._polls = player.polls("modbus")

        def stop(self) -> None: ...

        async def wait(self) -> int:
            polls = self._polls
            while polls and polls[0] <= clock.now() + 1e-6:
                polls.popleft()
            await clock.sleep(polls[0] - clock.now() if polls else self._period_s)
            number = round((clock.now() - self._begun) / self._period_s)
            self._number = max(number, self._number + 1)
            return self._number

    with ExitStack() as stack:
        stack.enter_context(patch("drivers.ur.arm.MotionClient", Motion))
        stack.enter_context(patch.object(ChildLink, "start", start))
        stack.enter_context(patch("drivers.ur.motion.same_pose", _as_solved_again))
        for reader in ("modbus_inputs.inputs", "observed_arm.reader"):
            stack.enter_context(patch(f"drivers.{reader}.Ticker", Ticker))
        for waits in ("modbus.link", "tracker.geocom_session"):
            stack.enter_context(patch(f"drivers.{waits}.answer_within", _patient))
        yield


def _as_solved_again(found: Array, wanted: Array) -> bool:
    """The walks of the crossed beams' solver go another way in a replay. So the tool's frame that it finds,
    which is set, differs by parts of its uncertainty from that which the recorded controller has."""
    apart = from_pose6(found).inv() * from_pose6(wanted)
    return bool(np.linalg.norm(apart.translation) < SOLVED_M and apart.rotation.magnitude() < SOLVED_RAD)


def _patient(seconds: float) -> AbstractAsyncContextManager[None]:
    """The recorded program did not count time that it lost while it waited. A replay loses none, and waits
    for the answer all the same."""
    return answer_within(seconds + PAUSE_S)


_NOTHING = 1e-9  # a figure that small is rounding, be it a length in m or an angle in rad
# Times of day and of solving, and raw samples: whether one at the edge of a window is in it may differ.
_LEFT_OUT = re.compile(r"(seconds|timing|trend|run_id|path|_at)\b|\.passes\b")


def compared(a: Any, b: Any) -> tuple[int, int, float, str]:
    """Of two results: figures, figures that differ, the largest difference and where it is.

    A difference is taken of the larger of the two numbers, or of the largest number beside them in a list:
    the third component of a vector may be all rounding. 1 stands for a text, or a list, that differs.
    """
    leaves = list(_leaves(a, b, "", 0.0))
    unequal = [(size, at) for at, size in leaves if size]
    most, where = max(unequal, default=(0.0, ""))
    return len(leaves), len(unequal), most, where


def _leaves(a: Any, b: Any, at: str, beside: float) -> Iterator[tuple[str, float]]:
    if _LEFT_OUT.search(at):
        return
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted({*a, *b}):
            yield from _leaves(a.get(key), b.get(key), f"{at}.{key}", 0.0)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        sizes = [abs(x) for x in (*a, *b) if isinstance(x, int | float)]
        for index, (one, other) in enumerate(zip(a, b, strict=True)):
            yield from _leaves(one, other, f"{at}[{index}]", max(sizes, default=beside))
    elif isinstance(a, int | float) and isinstance(b, int | float):
        yield at, 0.0 if a == b else abs(a - b) / max(abs(a), abs(b), beside, _NOTHING)
    else:
        yield at, 0.0 if a == b else 1.0
