"""A whole cell on real protocols for tests: twin and daemon as processes, and what an observer sees."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from cell.errors import CellError
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder, list_runs
from daemon.control_client import ControlClient
from fakes.twin.control import ask
from fakes.world.scenario import Scenario
from fakes.world.toml_text import to_toml
from procedures.hand_eye.record import CaptureRecord
from tests.kit.ideal_world import ideal_text, shipped_text
from tests.kit.pauses import Pauses

BIN = Path(sys.executable).parent
SPEED_AT_REST_RAD_S = 0.002
# By driver, for a machine that pauses: what a silence does to a run is shown on virtual time.
PATIENT_DEVICES: dict[str, dict[str, Any]] = {
    "ur": {"stale_after_s": 0.2, "silent_after_s": 0.5, "lost_after_s": 1.5, "watchdog_min_hz": 5.0},
    "oak": {"frame_timeout_s": 5.0},
    "canopen-encoder": {"lost_after_s": 1.0},
    "modbus-inputs": {"timeout_s": 0.5},
}
# How often a run may be interrupted here is judged by the pauses of this machine; one scene keeps the limits.
PATIENT = PATIENT_DEVICES | {"supervisor": {"silences_in_a_row": 30, "silences_in_all": 1000}}

# Keys of [cell.limits] for :func:`shipped`, where a test is not about speed.
BRISK: dict[str, Any] = {
    "speed_m_s": 0.5,
    "accel_m_s2": 2.0,
    "joint_speed_rad_s": "1.6\njoint_accel_rad_s2 = 6.0",
}


class WireCell:
    """Twin and daemon; the daemon can be killed, stopped and started again.

    ``limits``: other values of keys than the twin's cell.toml has, by driver or section; {} is the product.
    """

    def __init__(
        self, folder: Path, bind: str, scenario: str, limits: Mapping[str, dict[str, Any]] = PATIENT
    ) -> None:
        self.folder, self.bind, self.limits = folder, bind, limits
        self.pauses = Pauses()
        self.scenario = folder / "scenario.toml"
        self.scenario.write_text(scenario, "utf-8")
        self.twin: subprocess.Popen[bytes] | None = None
        self.daemon: subprocess.Popen[bytes] | None = None

    # -- processes

    def start_twin(self) -> None:
        command = [BIN / "cellward-twin", "--scenario", self.scenario, "--bind", self.bind]
        self.twin = self._spawn([*command, "--out", self.folder, "--with-parent"], "twin.log")
        twin = self.twin

        def begun() -> bool:
            assert twin.poll() is None, "the twin ended while it started"
            return (self.folder / "cell.toml").exists()

        wait_for(begun, "the twin's cell.toml", 120.0)
        self._set_limits()

    def _set_limits(self) -> None:
        """In the cell.toml that the twin wrote."""
        if not self.limits:
            return
        tables = self.config()
        if "supervisor" in self.limits:
            tables["supervisor"] = self.limits["supervisor"]
        for device in tables["device"].values():
            device |= self.limits.get(device["driver"], {})
        (self.folder / "cell.toml").write_text(to_toml(tables), "utf-8")

    def start_daemon(self) -> None:
        self.daemon = self._spawn(
            [BIN / "cellward", "run", "--config", self.folder / "cell.toml"], "daemon.log"
        )
        wait_for(self.ready, "ready devices", 120.0)

    def _spawn(self, command: list[Any], log: str) -> subprocess.Popen[bytes]:
        with (self.folder / log).open("ab") as out:
            return subprocess.Popen(
                [str(c) for c in command],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                preexec_fn=_as_the_service_runs,
            )

    def kill_daemon(self, number: signal.Signals = signal.SIGKILL) -> None:
        assert self.daemon is not None
        self.daemon.send_signal(number)
        if number == signal.SIGKILL:
            self.daemon.wait(10.0)
            self.daemon = None

    def child_pid(self, module: str) -> int:
        """Pid of the daemon's child that runs ``module``."""
        assert self.daemon is not None
        for child in psutil.Process(self.daemon.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                if any(module in word for word in child.cmdline()):
                    return child.pid
        raise LookupError(f"the daemon has no child {module}")

    def stop(self) -> None:
        self.pauses.stop()
        for process in (self.daemon, self.twin):
            if process is not None and process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.terminate()
                try:
                    process.wait(15.0)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait(5.0)
        self.daemon = self.twin = None

    # -- what the daemon says

    def call(self, method: str, **params: Any) -> Any:
        with ControlClient(Path(self.config()["cell"]["control_socket"])) as client:
            return client.call(method, **params)

    def status(self) -> dict[str, Any]:
        status: dict[str, Any] = self.call("status")
        return status

    def ready(self) -> bool:
        try:
            devices = self.status()["devices"].values()
        except CellError:
            return False
        return all(d["state"] == "READY" for d in devices)

    def start_job(self, job: str, params: Mapping[str, str] | None = None) -> int:
        """Start it, and confirm what it asks first: the board stands where it is to be; the tool is good."""
        self.pauses.forget()
        run: dict[str, int] = self.call("start", job=job, params=params or {})
        if job in ("cone-capture", "laser-reference"):
            wait_for(lambda: bool(self.status()["prompt"]), "first question of the job", 30.0)
            self.call("confirm", prompt_id=self.status()["prompt"]["id"])
        return run["run_id"]

    def undisturbed_end(self, timeout: float) -> dict[str, Any]:
        """:meth:`wait_for_end` of a run that only pauses of this machine may interrupt."""
        last = self.wait_for_end(timeout)
        self.pauses.require_explained(last["steps_taken_again"])
        return last

    def move_board(self) -> None:
        """As the twin's operator does when the job asks."""
        ask(self.folder, {"do": "operator", "next": True})

    def wait_for_end(self, timeout: float) -> dict[str, Any]:
        """The last run's end; the operator of the twin moves the board whenever the job asks."""
        give_up = time.monotonic() + timeout
        while time.monotonic() < give_up:
            status = self.status()
            if status["prompt"]:
                if not status["prompt"]["text"].startswith("Placement 1 "):  # there it stands
                    self.move_board()
                self.call("confirm", prompt_id=status["prompt"]["id"])
            if status["job"] is None and status["last_run"]:
                last: dict[str, Any] = status["last_run"]
                return last
            pause(0.05)
        raise TimeoutError(f"no end in {timeout} s: {self.status()}")

    # -- what is so

    def arm(self) -> dict[str, Any]:
        """The robot as it truly is."""
        state: dict[str, Any] = ask(self.folder, {"do": "truth"})["arm"]
        return state

    def moving(self) -> bool:
        return any(abs(v) > SPEED_AT_REST_RAD_S for v in self.arm()["qd"])

    def seconds_to_rest(self, limit: float) -> float:
        """Time until the arm is truly at rest, and it stays so for a moment."""
        begun = time.monotonic()
        while time.monotonic() - begun < limit:
            if not self.moving():
                return time.monotonic() - begun
            pause(0.005)
        raise AssertionError(f"the arm still moves after {limit} s: {self.arm()}")

    def stays_at_rest(self, seconds: float) -> None:
        begun, where = time.monotonic(), self.arm()["q"]
        while time.monotonic() - begun < seconds:
            now = self.arm()
            drift = max(abs(a - b) for a, b in zip(now["q"], where, strict=True))
            assert drift < 1e-6, f"the arm moved by itself: {drift} rad"
            pause(0.02)

    def inject(self, device: str, kind: str, **args: Any) -> None:
        ask(self.folder, {"do": "fault", "device": device, "kind": kind, "args": args})

    def runs(self) -> list[RunFolder]:
        return list_runs(Path(self.config()["cell"]["state_dir"]) / "runs")

    def finished_poses(self, run_id: int) -> list[dict[str, Any]]:
        run = next(r for r in self.runs() if r.run_id == run_id)
        return CaptureRecord.read(run.path).observations

    def config(self) -> dict[str, Any]:
        import tomllib

        return tomllib.loads((self.folder / "cell.toml").read_text("utf-8"))


def _as_the_service_runs() -> None:
    """The unit's Nice=, where the system permits it; a controller has a machine of its own."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, -5)


def shipped(name: str, real: bool = False, **keys: Any) -> str:
    """A shipped scenario, in an ideal world or a ``real`` one, with other numbers for keys of its jobs."""
    text = (shipped_text if real else ideal_text)(name)
    lines = []
    for line in text.splitlines():
        key = line.split("=")[0].strip()
        lines.append(f"{key} = {keys[key]}" if key in keys else line)
    text = "\n".join(lines) + "\n"
    Scenario.parse(text)
    return text


def pause(seconds: float) -> None:
    """Wait in a test without a loop."""
    time.sleep(seconds)


def wait_for(condition: Callable[[], bool], what: str, timeout: float) -> None:
    give_up = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < give_up, f"no {what} after {timeout} s"
        pause(0.02)


def calibrate_camera(cell: WireCell) -> None:
    """Commit ``T_base_camera`` as a calibration would have left it; only before the daemon starts."""
    config, truth = cell.config(), ask(cell.folder, {"do": "truth"})
    state = Path(config["cell"]["state_dir"])
    state.mkdir(mode=0o700, parents=True, exist_ok=True)
    with closing(Ledger(state / "ledger.sqlite")) as ledger:
        drawn = config["robot"]["T_base_camera_nominal"]
        found = {"result": {"lens": truth["camera"]}}
        ledger.accept(ledger.propose("T_base_camera", truth["T_base_camera"], found, 0, drawn), "test")


@contextmanager
def wire_cell(
    folder: Path,
    bind: str,
    scenario: str,
    first: Callable[[WireCell], None] = lambda cell: None,
    limits: Mapping[str, dict[str, Any]] = PATIENT,
) -> Iterator[WireCell]:
    """Twin and daemon, both ready; ended whatever happens, their logs shown when the test fails.

    ``first`` is done between the two starts; ``limits`` as :class:`WireCell` takes them.
    """
    cell = WireCell(folder, bind, scenario, limits)
    try:
        cell.pauses.start()
        cell.start_twin()
        first(cell)
        cell.start_daemon()
        yield cell
    except BaseException:
        for name in ("twin.log", "daemon.log"):
            path = folder / name
            print(f"--- {name}\n{path.read_text('utf-8', 'replace')[-4000:] if path.exists() else 'none'}")
        raise
    finally:
        cell.stop()
        for path in folder.glob("*.sock"):
            os.unlink(path)
