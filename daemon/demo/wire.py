"""The demo on real protocols: twin and daemon as processes, jobs triggered over Modbus, and one over CAN."""

import json
import signal
import socket
import stat
import subprocess
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

from cell.errors import CellError, RetryError, error, find_entry
from cell.interruptions import SILENCES
from cell.store.files import disk_errors
from cell.store.ledger import Ledger
from daemon.cli.failures import FAILED
from daemon.cli.output import out, say
from daemon.cli.progress import ProgressBar
from daemon.demo import plc as registers
from daemon.demo.beside import ObjectSteps
from daemon.demo.can_node import GATEWAY_PORT, PlcOnCan, share_encoders_bus
from daemon.demo.children import Child, console_script
from daemon.demo.closing import Row, beside_ideal, close_demo
from daemon.demo.ending import conclude
from daemon.demo.folder import begin_in
from daemon.demo.page import DemoPage
from daemon.demo.plc import POLL_S, Plc
from daemon.demo.scenes import DemoScene, give_camera, scenes_of
from daemon.demo.steps import Bump, Step, eta_text
from daemon.report_index import CellState

# UR's four; Modbus servers; GeoCOM; CAN.
NEEDED_PORTS = (29999, 30001, 30003, 30004, 5020, 5502, 1212, GATEWAY_PORT)
TWIN_START_S = 60.0
DAEMON_START_S = 90.0
JOB_DEADLINE_S = 15 * 60.0
TWIN_ANSWER_S = 30.0
LAST_WORDS_S = 3.0
PASSING = {"STALE_DATA", "DEVICE_NOT_READY"}
LATE = SILENCES | {"CALL_TIMEOUT"}  # what a machine without a free core ends a run with
ATTEMPTS = 2
START_ATTEMPTS, START_AGAIN_S = 4, 0.8
LINE_EVERY_STEPS = 10
STATE = "state"  # as the twin names it in its cell.toml


def run_wire(folder: Path, steps: Sequence[Step]) -> int:
    """Run the demo with its files in ``folder``; exit code 0 only when every answer agrees with the truth.

    A scene that cannot go on costs its own steps; the others are shown all the same.
    """
    page = DemoPage.on_a_free_port()
    duration, shown = eta_text(steps).split(": ", 1)
    if any(not step.objects for step in steps):
        out(f"Cellward demo on a twin; watch it live on {page.address} (ETA {duration})")
        say(f"The page comes with each daemon of the demo; to act on it, log in with {page.token}")
    else:
        out("Cellward demo on virtual devices and a virtual clock: there is no protocol and no page.")
    say(f"It shows: {shown}.")
    rows: list[Row] = []
    objects = ObjectSteps(folder, [step for step in steps if step.objects])
    ideal = ObjectSteps(folder, steps, ideal=True)
    scenes = scenes_of([step for step in steps if not step.objects])
    with _interrupted_once():
        say(f"Files and logs go to {folder}")
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with objects.begun(), ideal.begun():
            rows += _all(scenes, folder, page)
            rows += objects.rows()
            rows = beside_ideal(rows, ideal.rows())
    twins = [CellState(scene.twin, folder / scene.twin / STATE) for scene in scenes]
    return close_demo(rows, [*twins, *objects.cells()], folder)


def _all(scenes: Sequence[DemoScene], folder: Path, page: DemoPage) -> list[Row]:
    rows: list[Row] = []
    for scene in scenes:
        done: list[Finished] = []
        lost = None
        try:
            _play(scene, folder / scene.twin, done, page)
        except CellError as failure:
            say(f"{failure}. {failure.hint}")
            lost = failure
        own = [conclude(*run) if isinstance(run, tuple) else run for run in done]
        own += [Row(s.job, "-", "-", f"not done: {lost}", FAILED) for s in scene.steps[len(done) :]]
        rows += [replace(row, twin=scene.twin) for row in own]
    return rows


Finished = tuple[Path, int, dict[str, Any]] | Row
"""The folder of runs, the number of the run and the truth after it; or why there is none."""


def _play(scene: DemoScene, folder: Path, done: list[Finished], page: DemoPage) -> None:
    """All steps in one twin with one daemon; what is done of them is appended to ``done``."""
    begin_in(folder, STATE, "demo")
    config, failed = folder / "cell.toml", set[str]()
    scenario = scene.prepare(folder)
    with _no_socket_left(folder), _twin(folder, config, scenario) as twin:
        page.add_to(config)
        settings = tomllib.loads(config.read_text("utf-8"))
        if any(step.over_can for step in scene.steps):
            share_encoders_bus(config, settings["device"][settings["robot"]["belt"]]["bus"])
        where = Path(settings["cell"]["state_dir"]) / "runs"
        if scene.given_camera:
            where.mkdir(parents=True)
            with closing(Ledger(where.parent / "ledger.sqlite")) as ledger:
                truth = json.loads(_ask_twin(folder, "truth", "--json"))
                give_camera(ledger, truth, settings["robot"]["T_base_camera_nominal"])
        with _daemon(folder, config) as daemon, _plc(settings) as plc:
            say(f"twin '{scene.twin}' pid {twin.pid}, daemon pid {daemon.pid}; waiting for the devices")
            daemon.wait_for(plc.connect, "Modbus server", DAEMON_START_S)
            for step in scene.steps:
                if step.after in failed:
                    failed.add(step.job)
                    done.append(Row(step.job, "-", "-", f"not tried: it needs {step.after}", FAILED))
                    continue
                try:
                    run_id, met, status = _try_step(plc, step, folder, (twin, daemon))
                except RetryError:  # a lost link; a daemon that is gone is the better reason
                    daemon.check_alive(LAST_WORDS_S)
                    raise
                if status.error_code:
                    failed.add(step.job)
                truth = json.loads(_ask_twin(folder, "truth", "--json"))
                if step.picks:  # of this run alone
                    del truth["gripper"]["contacts"][:met]
                done.append((where, run_id, truth))


def _try_step(
    plc: PlcOnCan, step: Step, folder: Path, children: tuple[Child, Child]
) -> tuple[int, int, registers.Status]:
    """The number of the run, how many items the gripper had met before, and how it ended.

    A run that ended because something was late is no result: it is taken once more. The operator has a look
    and takes out what the gripper holds, the PLC resets the fault and starts the job again.
    """
    for left in reversed(range(ATTEMPTS)):
        _wait_ready(plc, children[1], step)
        met = (
            len(json.loads(_ask_twin(folder, "truth", "--json"))["gripper"]["contacts"]) if step.picks else 0
        )
        status = _run_step(plc, step, folder, children)
        late = find_entry(status.error_code) if status.error_code else None
        if not left or late is None or late.name not in LATE:
            break
        say(
            f"run {status.run_id} was ended by {late.name}: something came too late too often, as where no "
            "core is free; the PLC resets the fault and starts the job once more"
        )
        if step.picks:
            _tell_twin(plc, folder, "operator", "empty")
        plc.command(registers.RESET)
    return status.run_id, met, status


def _wait_ready(plc: Plc, daemon: Child, step: Step) -> None:
    daemon.wait_for(lambda: plc.poll().ready_with(step.needs), f"devices of {step.job}", DAEMON_START_S)


def _run_step(plc: PlcOnCan, step: Step, folder: Path, children: tuple[Child, ...]) -> registers.Status:
    """Start the job as a PLC does, play the operator when it asks, and acknowledge the result; what was read
    last before that."""
    begun = time.monotonic()
    if step.bump is not None:
        _bump(plc, folder, step.bump)
    _start(plc, step)
    say(f"the PLC started job {step.number} ({step.job}) over {'CAN' if step.over_can else 'Modbus'}")
    answered, placement, told, finished = 0, 0, 0, False
    with ProgressBar() as bar:
        while (status := plc.poll()).busy:
            for child in children:
                child.check_alive()
            if time.monotonic() - begun > JOB_DEADLINE_S:
                raise error("CALL_TIMEOUT", f"{step.job} had no end in {JOB_DEADLINE_S:g} s")
            bar.show(f"{step.job}, run {status.run_id}", status.step, status.steps)
            if not bar.visible and status.step >= told + LINE_EVERY_STEPS:
                told = status.step
                of = f" of {status.steps}" if status.steps else ""  # 0: without an end of its own
                say(f"step {status.step}{of}, {time.monotonic() - begun:.0f} s")
            if step.picks and status.picks >= step.picks and not finished:
                say(f"{status.picks} picks; the PLC finishes the job")
                finished = True
                plc.command(registers.FINISH)
            if status.held:
                plc.command(registers.RESUME)
                say(f"run {status.run_id} was held; the operator had a look, and the PLC resumed it")
            if status.prompt_id not in (0, answered):
                placement += 1
                did = _play_operator(plc, folder, step, placement)
                plc.command(registers.CONFIRM, argument=status.prompt_id)
                answered = status.prompt_id
                say(f"prompt {answered}: {did}; the PLC confirmed")
            time.sleep(POLL_S)
    plc.command(registers.ACKNOWLEDGE)
    say(f"run {status.run_id} ended after {time.monotonic() - begun:.0f} s; the PLC acknowledged the result")
    return status


def _start(plc: PlcOnCan, step: Step) -> None:
    """Ask for the job; again when a device was late just then, for a refused start has done nothing."""
    for attempt in range(START_ATTEMPTS):
        try:
            if step.over_can:
                plc.start_over_can(step.number)
            else:
                plc.command(registers.START, job=step.number)
            return
        except CellError as refusal:
            if refusal.name not in PASSING or attempt + 1 == START_ATTEMPTS:
                raise
            say(f"{refusal}; the PLC asks again")
            time.sleep(START_AGAIN_S)
            plc.poll()


def _play_operator(plc: Plc, folder: Path, step: Step, placement: int) -> str:
    """Do in the twin what the prompt asks for; returns what was done."""
    if not step.moves_board:
        return "the operator has done what it asks for"
    _tell_twin(plc, folder, "operator", "place", str(placement))
    return f"the operator put the board at place {placement}"


def _bump(plc: Plc, folder: Path, bump: Bump) -> None:
    shift = (f"--d{axis}={value!r}" for axis, value in zip("xyz", bump.shift_m, strict=True))
    tilt = (f"--r{axis}={value!r}" for axis, value in zip("xy", bump.tilt_rad, strict=True))
    _tell_twin(plc, folder, "tool", "bend", *shift, *tilt)
    millimetres = ", ".join(f"{1e3 * v:g}" for v in bump.shift_m)
    say(f"the tool was bumped: its point is off by ({millimetres}) mm and its axis is bent")


def _tell_twin(plc: Plc, folder: Path, *words: str) -> None:
    """Give the twin a command, and keep beating meanwhile."""
    command = [str(console_script("cellward-twin")), *words, "--out", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        give_up = time.monotonic() + TWIN_ANSWER_S
        try:
            while process.poll() is None:
                if time.monotonic() > give_up:
                    raise error("CALL_TIMEOUT", f"the twin's '{words[0]}', after {TWIN_ANSWER_S:g} s")
                plc.poll()
                time.sleep(POLL_S)
        finally:
            process.kill()
    if process.returncode != 0:
        raise error("CHILD_DIED", f"'{' '.join(command)}' ended with code {process.returncode}")


@contextmanager
def _twin(folder: Path, config: Path, scenario: str) -> Iterator[Child]:
    config.unlink(missing_ok=True)
    with free_address() as address:
        where = ["--bind", address, "--out", str(folder)]
        command = [str(console_script("cellward-twin")), "--scenario", scenario, *where]
        with Child("twin", command, folder / "twin.log") as twin:
            twin.wait_for(config.exists, "cell.toml", TWIN_START_S)
            yield twin


@contextmanager
def free_address() -> Iterator[str]:
    """A loopback address on which nobody, such as another twin, uses a port that the demo needs.

    A twin takes its ports a while later. Two demos that begin at the same moment are kept apart by a socket
    with the address for its name, which is gone with the process.
    """
    for number in range(2, 10):
        address = f"127.0.0.{number}"
        with socket.socket(socket.AF_UNIX) as claim:
            try:
                claim.bind(f"\0cellward-demo-{address}")
            except OSError:
                continue
            if all(_can_listen(address, port) for port in NEEDED_PORTS):
                yield address
                return
    raise error("NOT_NOW", "on 127.0.0.2 to 127.0.0.9 the ports of the twin are in use; stop a twin first")


def _can_listen(address: str, port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
        except OSError:
            return False
    return True


@contextmanager
def _daemon(folder: Path, config: Path) -> Iterator[Child]:
    command = [str(console_script("cellward")), "run", "--config", str(config)]
    with Child("daemon", command, folder / "daemon.log") as daemon:
        yield daemon


def _plc(settings: dict[str, Any]) -> PlcOnCan:
    host, _, port = settings["modbus"]["bind"].rpartition(":")
    return PlcOnCan(host, int(port))


def _ask_twin(folder: Path, *words: str) -> str:
    command = [str(console_script("cellward-twin")), *words, "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TWIN_ANSWER_S, check=False)
    if done.returncode != 0:
        raise error(
            "CHILD_DIED", f"'{' '.join(command)}' ended with code {done.returncode}: {done.stderr.strip()}"
        )
    return done.stdout


@contextmanager
def _interrupted_once() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the demo in order; a second one does not break into that order."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _no_socket_left(folder: Path) -> Iterator[None]:
    """Take away the socket files of children that had to be killed; one that still answers is not ours."""
    try:
        yield
    finally:
        for path in folder.iterdir():
            if stat.S_ISSOCK(path.lstat().st_mode) and not _answers(path):
                path.unlink()


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True
