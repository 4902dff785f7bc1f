"""What a pause of a process costs: each is stopped for a while in every state of every job, on the wire.

``python -m bench.hiccups [JOB]... [--pauses 0.05,0.15,0.5,1.5,5] [--minutes 20] [--bind 127.0.53.3]
[--record FILE]``. Twin, daemon, motion child and vision child are stopped with SIGSTOP and go on with
SIGCONT. All limits are the product's own. Several pauses strike one run, each after a step that the one
before did not touch has ended, until every state has met every process and pause, or the minutes are over.
What struck is added to FILE, and what is in FILE is not done again: the table may be made in several goes.
``went on``: pauses after which the run ended a step again, or was complete. Any other one is the last of its
run. ``right``: of those in runs that were complete in the end, those whose answer agrees with the twin's
truth within its stated uncertainty. ``rest``: the longest time from the stop to the arm's true standstill, of
pauses of half a second and more that found the arm moving. It is asked of the daemon and the motion child:
pictures that do not come stop no move, and a twin that is stopped tells nothing. The row ``none`` is a run
that nothing struck.
"""

import argparse
import json
import os
import signal
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from bench._expected import expect
from bench.slot_wire import OCCUPIED, SLOTS, give_hand_eye
from bench.slot_wire import scenario as rack_scenario
from cell.calibrations import kinematics
from cell.errors import CellError
from cell.poses import from_pose6, to_pose6
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder, load_run
from daemon.demo.ending import beside_truth
from fakes.twin.control import ask
from fakes.world.scenario import OBSERVED, Scenario
from procedures.beside_truth import Judged
from procedures.documents import kind_of
from procedures.registry import JOBS
from tests.kit.wire_cell import WireCell, calibrate_camera, pause, shipped, wire_cell

PAUSES_S = (0.05, 0.15, 0.5, 1.5, 5.0)
PROCESSES = ("daemon", "arm child", "vision child", "twin")
MOVERS = ("daemon", "arm child")  # without these the arm must stop
APART_S = 1.0  # between two pauses in one run, after the run has gone on
PER_RUN = 8
TAKEN_AGAIN = 6  # no more pauses after so many steps: ten end a run, and one pause may cost two
LONG_S = 0.5
GRIPPING = ("belt-tracking", "slot-insertion")  # what these hold as they abort is taken from the gripper
RUN_LIMIT_S = 300.0
MOTION, VISION = "drivers.ur.motion_child", "daemon.vision_child"


@dataclass(frozen=True)
class InterruptedJob:
    """A job, the scenario it runs in (``made`` where it is not as shipped), the jobs before it, whether it
    sees with a camera, what its n-th run is started with, and what a person does when it asks, by its
    status."""

    scenario: str
    before: tuple[str, ...] = ()
    camera: bool = False
    first: Callable[[WireCell], None] = lambda cell: None
    finish_after_s: float | None = None
    keys: dict[str, Any] = field(default_factory=dict)
    more: str = ""
    made: Callable[[], str] | None = None
    params: Callable[[int], dict[str, str]] = lambda run: {}
    answer: Callable[[WireCell, dict[str, Any]], None] = lambda cell, status: place_target(cell)

    @property
    def text(self) -> str:
        """The scenario's own text."""
        if self.made is not None:
            return self.made()
        return shipped(self.scenario, **self.keys) + self.more


def place_target(cell: WireCell) -> None:
    """The target is put where it is wanted next."""
    ask(cell.folder, {"do": "operator", "next": True})


def leave_target(cell: WireCell, status: dict[str, Any]) -> None:
    """The target is where the job wants it from the start."""


def hold_point(cell: WireCell, status: dict[str, Any]) -> None:
    """The tool's point is brought over the corner that the job is at."""
    corner = int(status["live"]["corner"])
    order = {"do": "operator", "over": corner, "gauge_m": GAUGE_M, "hand_m": HAND_M}
    pause(ask(cell.folder, order))


def free_rack(cell: WireCell) -> None:
    """A calibrated camera, and the board, which covers the rack, taken away; before the daemon starts."""
    give_hand_eye(cell, 0)
    ask(cell.folder, {"do": "operator", "remove": True})


def fill_slot(run: int) -> dict[str, str]:
    """A part is inserted into the next slot that is free, and then replaced by another one."""
    free = [n for n in range(1, SLOTS + 1) if n != OCCUPIED]
    return {"slot": str(free[run // 2 % len(free)]), "action": ("insert", "replace")[run % 2]}


def calibrate_palletizer(cell: WireCell) -> None:
    """Commit the observed arm's true kinematics, as of a sampling; only before the daemon starts."""
    state = Path(cell.config()["cell"]["state_dir"])
    state.mkdir(mode=0o700, parents=True, exist_ok=True)
    with closing(Ledger(state / "ledger.sqlite")) as ledger:
        value = observed_kinematics(ask(cell.folder, {"do": "truth"}))
        ledger.accept(ledger.propose(kinematics(OBSERVED), value, {}, 0, None), "bench")


def observed_kinematics(truth: dict[str, Any]) -> dict[str, Any]:
    """What a perfect sampling of the palletizer would have found, by the twin's ``truth``."""
    tracker = truth["tracker"]
    place = dict(zip(("tx", "ty", "tz"), tracker["reflectors"]["smr1"]["point"], strict=True))
    return {
        "robot": {"family": "palletizer4", "parameters": truth["observed"]["parameters"] | place},
        "T_base_tracker": tracker["T_base_tracker"],
        "payload_kg": 60.0,
        "predicted_95": 1e-4,
    }


def eye_to_hand() -> str:
    """A check whose target is where the scenario truly has it on the flange."""
    on_flange = Scenario.load("hand_eye_to_hand:ideal").world.target_mounts[0]
    place = to_pose6(from_pose6(on_flange).inv()).tolist()
    return f"""
[cell.job.eye-to-hand-check]
target = "board"
T_marker_flange = {place}
start_pose = "home"
poses = 14
min_poses = 12
nearest_m = 0.4
farthest_m = 0.7
"""


GAUGE_M, HAND_M = 0.008, 0.0002  # thick, as how large the board was printed is not known here
TOUCH = f"""
[cell.job.touch-test]
target = "board"
look_pose = "home"
stand_off_m = {GAUGE_M}
clear_m = 0.015
"""
ISO9283 = """
[cell.job.iso9283]
reflector = "smr1"
point = [-0.05, 0.0, 0.06]
cube = { centre = [-0.6, -0.5, 0.7], edge_m = 0.3, R_base_flange = [1.3818, -0.7395, -0.7817] }
cycles = 3
settle_s = 0.3
window_s = 0.4
T_base_tracker_nominal = [-2.385, -1.715, 1.11, 0.004, -0.006, -0.943]
"""
SCENES = {
    "cone-capture": InterruptedJob("bay", camera=True, keys={"placements": 1, "poses_per_placement": 8}),
    "laser-reference": InterruptedJob("bay"),
    "laser-check": InterruptedJob("bay", before=("laser-reference",)),
    "laser-update": InterruptedJob("bay", before=("laser-reference",)),
    "latency-calibration": InterruptedJob("bay", before=("laser-reference",)),
    "tracker-sampling": InterruptedJob("tracker", keys={"poses": 16}),
    "iso9283": InterruptedJob("tracker", more=ISO9283),
    "belt-calibration": InterruptedJob("picking", camera=True, first=calibrate_camera),
    "belt-tracking": InterruptedJob("picking", camera=True, first=calibrate_camera, finish_after_s=45.0),
    "eye-to-hand-check": InterruptedJob(
        "hand_eye_to_hand", camera=True, first=calibrate_camera, more=eye_to_hand(), answer=leave_target
    ),
    "touch-test": InterruptedJob(
        "hand_eye", camera=True, first=partial(give_hand_eye, seed=0), more=TOUCH, answer=hold_point
    ),
    "corrected-targets": InterruptedJob("palletizer", first=calibrate_palletizer),
    "slot-insertion": InterruptedJob(
        "slot", camera=True, first=free_rack, made=partial(rack_scenario, 2 * SLOTS, 0), params=fill_slot
    ),
}


@dataclass
class Strike:
    """One process stopped once, at a state of the job."""

    process: str
    pause_s: float
    state: str
    rest_s: float | None = None
    went_on: bool = False
    end: str = ""
    right: bool | None = None  # does the answer agree with the truth? None: no answer, or no truth for it

    @property
    def what(self) -> tuple[str, float, str]:
        return self.process, self.pause_s, self.state


def accept_proposed(cell: WireCell, run_id: int) -> None:
    """Put into effect what the run proposed."""
    ledger = Ledger(cell.folder / "state" / "ledger.sqlite", read_only=True)
    rows = ledger.results()
    ledger.close()
    for row in rows:
        if row["run_id"] == run_id and row["state"] == "proposed":
            with suppress(CellError):
                cell.call("accept", result_id=row["id"])


class Bench:
    """All pauses of one job in one cell."""

    def __init__(
        self, cell: WireCell, job: str, pauses: tuple[float, ...], until: float, record: Path | None
    ) -> None:
        self.cell, self.job, self.scene, self.until, self.record = cell, job, SCENES[job], until, record
        self.done = recorded(record, job)
        done = {strike.what for strike in self.done}
        states = [s.value for s in JOBS[job].State]
        self.pending = [
            Strike(process, seconds, state)
            for seconds in pauses
            for process in PROCESSES
            for state in states
            if (process != "vision child" or self.scene.camera) and (process, seconds, state) not in done
        ]
        self.runs = 0

    def run(self) -> None:
        for job in self.scene.before:
            self.cell.start_job(job)
            end = self.cell.wait_for_end(RUN_LIMIT_S)
            accept_proposed(self.cell, end["run_id"])
        self._one(strike=False)
        idle = 0
        while self.pending and time.monotonic() < self.until and idle < 3:
            before = len(self.done)
            self._one(strike=True)
            idle = 0 if len(self.done) > before else idle + 1

    def _one(self, strike: bool) -> None:
        """One run, struck wherever a state comes that a pause is still wanted for."""
        cell, mine = self.cell, list[Strike]()
        self._make_ready()
        met = len(self._truth().get("gripper", {}).get("contacts", ()))
        run_id = cell.start_job(self.job, self.scene.params(self.runs))
        begun = free = time.monotonic()
        finished = spent = False
        while (status := self._status())["job"] is not None:
            now = time.monotonic()
            if status["prompt"]:
                with suppress(CellError):
                    self.scene.answer(cell, status)
                with suppress(CellError):
                    cell.call("confirm", prompt_id=status["prompt"]["id"])
            limit = self.scene.finish_after_s
            if (limit is not None and now - begun > limit and not finished) or now - begun > RUN_LIMIT_S:
                finished = True
                with suppress(CellError):
                    cell.call("finish")
            settled = now >= free and status["packml"] == "EXECUTE" and not status["silences_in_a_row"]
            if settled and mine:
                mine[-1].went_on = True
            last = len(mine) >= PER_RUN - 1 or status["steps_taken_again"] >= TAKEN_AGAIN
            if strike and settled and not spent and (due := self._due(status["state"], last)):
                spent = last
                mine.append(due)
                self._strike(due)
                free = time.monotonic() + APART_S
            pause(0.02)
        end = self._status()["last_run"]
        self.runs += 1
        outcome = end["outcome"] + (
            f" {end['error']['name']}: {end['error']['text']}" if end["error"] else f" {end['verdict']}"
        )
        run = load_run(Path(cell.config()["cell"]["state_dir"]) / "runs", run_id)
        journal = run.read_journal()
        again = [line for line in journal if line.get("event") == "step taken again"]
        judged = self._judged(run, met) if end["outcome"] == "complete" else None
        told = ", ".join(f"{s.process} {s.pause_s:g} s at {s.state}" for s in mine) or "none"
        answer = f" ({judged.off}; stated {judged.stated})" if judged else ""
        wrong = " NOT AS STATED" if judged and not judged.good else ""
        print(
            f"  run {run_id}: {outcome}{wrong}{answer}; {len(again)} steps again; struck: {told}",
            flush=True,
        )
        if end["error"]:
            lines = [line for line in journal if line.get("kind") in ("device", "error") or line.get("cause")]
            for line in lines[-6:]:
                print(f"    {line}", flush=True)
        if mine and end["outcome"] == "complete":
            mine[-1].went_on = True
        for each in mine:
            each.end = outcome
            each.right = judged.good if judged else None
            self.done.append(each)
            if self.record is not None:
                with self.record.open("a", encoding="utf-8") as out:
                    out.write(json.dumps({"job": self.job, **asdict(each)}) + "\n")

    def _judged(self, run: RunFolder, met: int) -> Judged | None:
        """The answer beside the truth; of the twin's contacts those after the first ``met``."""
        truth, result = self._truth(), run.read_result()
        if met:
            del truth["gripper"]["contacts"][:met]
        if not result or not result["result"] or not kind_of(result).truth:
            return None
        return beside_truth(result, truth, run.path)

    def _truth(self) -> dict[str, Any]:
        truth: dict[str, Any] = ask(self.cell.folder, {"do": "truth"})
        return truth

    def _due(self, state: str, last: bool) -> Strike | None:
        """A pause that is wanted for ``state``: the shortest, but the longest as the ``last`` of a run.

        What is likely to end a run costs no run of its own so.
        """
        for each in reversed(self.pending) if last else self.pending:
            if each.state == state and self._pids(each.process):
                self.pending.remove(each)
                return each
        return None

    def _strike(self, strike: Strike) -> None:
        pids = self._pids(strike.process)
        moving = strike.process in MOVERS and strike.pause_s >= LONG_S and self.cell.moving()
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
        stopped = time.monotonic()
        try:
            while moving and time.monotonic() - stopped < strike.pause_s:
                if not self.cell.moving():
                    strike.rest_s = time.monotonic() - stopped
                    break
                pause(0.005)
            pause(max(stopped + strike.pause_s - time.monotonic(), 0.0))
        finally:
            for pid in pids:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)

    def _pids(self, process: str) -> list[int]:
        cell = self.cell
        if process == "twin":
            tree = psutil.Process(expect(subprocess.Popen, cell.twin).pid)
            return [tree.pid, *(child.pid for child in tree.children(recursive=True))]
        if process == "daemon":
            return [expect(subprocess.Popen, cell.daemon).pid]
        try:
            return [cell.child_pid(MOTION if process == "arm child" else VISION)]
        except LookupError:
            return []

    def _status(self) -> dict[str, Any]:
        for _ in range(100):
            with suppress(CellError):
                return self.cell.status()
            pause(0.1)
        return self.cell.status()

    def _make_ready(self) -> None:
        give_up = time.monotonic() + 60.0
        while time.monotonic() < give_up:
            with suppress(CellError):
                if self.cell.ready():
                    if self.cell.status()["packml"] in ("ABORTED", "STOPPED"):
                        if self.job in GRIPPING:
                            ask(self.cell.folder, {"do": "gripper", "empty": True})
                        self.cell.call("reset")
                    return
            pause(0.2)
        raise TimeoutError(f"the cell did not get ready: {self.cell.status()}")


def recorded(record: Path | None, job: str) -> list[Strike]:
    """What struck ``job`` according to ``record``, which need not exist yet."""
    if record is None or not record.exists():
        return []
    lines = [json.loads(line) for line in record.read_text("utf-8").splitlines()]
    return [Strike(**{k: v for k, v in line.items() if k != "job"}) for line in lines if line["job"] == job]


def table(benches: list[Bench]) -> None:
    print(f"\n{'job':20} {'process':13} {'pause':>7} {'struck':>7} {'went on':>9} {'right':>9} {'rest':>8}")
    for bench in benches:
        groups: dict[tuple[str, float], list[Strike]] = defaultdict(list)
        for strike in bench.done:
            groups[strike.process, strike.pause_s].append(strike)
        for (process, seconds), strikes in sorted(groups.items(), key=lambda g: (g[0][1], g[0][0])):
            rests = [s.rest_s for s in strikes if s.rest_s is not None]
            rest = f"{max(rests):.2f} s" if rests else "-"
            good = sum(s.went_on for s in strikes)
            compared = [s.right for s in strikes if s.right is not None]
            right = f"{sum(compared)}/{len(compared)}" if compared else "-"
            print(
                f"{bench.job:20} {process:13} {seconds:5g} s {len(strikes):7d} {good:5d}/{len(strikes):<3d} "
                f"{right:>9} {rest:>8}"
            )
        left = len(bench.pending)
        met = {strike.state for strike in bench.done}
        never = ", ".join(s.value for s in JOBS[bench.job].State if s.value not in met) or "none"
        print(
            f"{bench.job:20} {bench.runs} runs; {left} of {left + len(bench.done)} pauses were not reached; "
            f"states that did not come: {never}"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=", ".join(SCENES))
    parser.add_argument("--pauses", default=",".join(f"{p:g}" for p in PAUSES_S))
    parser.add_argument("--minutes", type=float, default=20.0, help="for each job")
    parser.add_argument("--bind", default="127.0.53.3")
    parser.add_argument("--record", type=Path, metavar="FILE", help="JSON lines, one a pause")
    options = parser.parse_args()
    if unknown := sorted(set(options.jobs) - set(SCENES)):
        parser.error(f"no job '{unknown[0]}'; there is {', '.join(SCENES)}")
    pauses = tuple(float(p) for p in options.pauses.split(","))
    benches = []
    for job in options.jobs or SCENES:
        scene = SCENES[job]
        print(f"{job}: scenario {scene.scenario}", flush=True)
        with (
            tempfile.TemporaryDirectory(prefix="cellward-hiccups-") as folder,
            wire_cell(Path(folder), options.bind, scene.text, scene.first, limits={}) as cell,
        ):
            until = time.monotonic() + 60.0 * options.minutes
            bench = Bench(cell, job, pauses, until, options.record)
            benches.append(bench)
            try:
                bench.run()
            except (TimeoutError, CellError) as exc:
                print(f"  {job} was left: {exc}", flush=True)
    table(benches)


if __name__ == "__main__":
    main()
