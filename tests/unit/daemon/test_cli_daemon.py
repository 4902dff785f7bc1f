"""Commands that talk to the daemon, against a stand-in engine on a real control socket."""

import json
import subprocess
import sys
import threading
import time
from typing import Any

import pytest

from cell.errors import error
from daemon.start_request import StartRequest
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result
from tests.kit.control_harness import RecordingEngine, served

IDLE: dict[str, Any] = {
    "cell": "bay-3", "twin": True, "packml": "IDLE", "job": None, "run_id": None, "state": None, "step": 0,
    "steps": 0, "prompt": None, "error": None, "latched": False, "last_run": None, "interrupted": [4],
    "devices": {"arm": {"state": "READY", "model": "UR10e", "serial": "99991", "error": None},
                "camera": {"state": "RETRYING", "model": None, "serial": None, "error": "no cable"}},
}  # fmt: skip
RUNNING = IDLE | {
    "packml": "HELD", "job": "cone-capture", "run_id": 7, "state": "place", "step": 20, "steps": 60,
    "prompt": {"id": 458753, "text": "Placement 2 of 3: Move the board."},
}  # fmt: skip


class TalkingEngine(RecordingEngine):
    """Has a full status, and ends its run when it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.now: dict[str, Any] = IDLE

    def status(self) -> dict[str, Any]:
        return self.now

    async def start(self, request: StartRequest) -> dict[str, Any]:
        answer = await super().start(request)
        if not request.dry_run:
            self.now = RUNNING
        return answer

    def end(self, outcome: str, verdict: str | None, failure: dict[str, Any] | None = None) -> None:
        result = hand_eye_result(verdict=verdict or "fail") if outcome == "complete" else None
        last = {"run_id": 7, "job": "cone-capture", "outcome": outcome, "verdict": verdict, "error": failure}
        self.now = IDLE | {"last_run": {**last, "result": result}}
        for listener in tuple(self.listeners):
            listener()


@pytest.fixture
def engine() -> TalkingEngine:
    return TalkingEngine()


def test_status_shows_state_devices_and_what_to_do(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine
) -> None:
    engine.now = RUNNING | {"error": error("ARM_PROTECTIVE_STOP").as_dict(), "latched": True}
    with served(cell.socket, engine):
        shown, as_json = subject("status"), subject("status", "--json")
    for told in (
        "bay-3 (twin): HELD", "run 7: place, 20 of 60", "cellward confirm 458753", "(3001)", "cellward reset",
        "no cable", "cellward adopt 4",
    ):  # fmt: skip
        assert told in shown.out
    assert json.loads(as_json.out) == engine.now


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (("confirm", 458753), ("confirm", 458753)),
        (("finish",), ("finish",)),
        (("abort",), ("abort",)),
        (("halt",), ("halt",)),
        (("pause",), ("pause",)),
        (("resume",), ("resume",)),
        (("reset",), ("reset",)),
    ],
)
def test_a_verb_reaches_the_engine_and_says_what_happens_now(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine, words: Any, asked: Any
) -> None:
    with served(cell.socket, engine):
        done = subject(*words)
    assert (done.code, done.out) == (0, "")
    assert done.err.strip()
    assert engine.asked[0][: len(asked)] == asked


def test_start_prints_the_run_and_hands_over_the_parameters(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine
) -> None:
    with served(cell.socket, engine):
        done = subject("start", "cone-capture", "-p", "settle_s=0.5", "-p", "placements=1")
    assert (done.code, done.out) == (0, "7\n")
    request = engine.asked[0][1]
    assert (request.job, request.dry_run) == ("cone-capture", False)
    assert request.params == {"settle_s": "0.5", "placements": "1"}


def test_adopt_starts_the_same_job_with_the_same_parameters(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine
) -> None:
    cell.add_run(4)
    with served(cell.socket, engine):
        assert subject("adopt", 4).code == 0
    request = engine.asked[0][1]
    assert (request.job, request.adopt, request.dry_run) == ("cone-capture", 4, False)
    assert request.params == {"settle_s": "0.5"}


def test_a_dry_run_lists_the_plan_and_its_checks(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine
) -> None:
    engine.plan = {
        "kind": "hand-eye",
        "axis": "board normal",
        "poses": [
            {
                "index": 0, "q": [0.0, -1.5707963, -1e-9, 0.0, 0.0, 0.0], "travel_rad": 0.1,
                "checks": {"joint_rad": 0.5, "joint": "elbow", "clearance_m": 0.0123, "clearance": "tool"},
            }
        ],
        "rejected": [{"index": 1, "reason": "enters keep-out box 'pillar'"}],
        "predicted": {
            "error95_t_m": 1.5e-4, "error95_r_rad": 2e-4,
            "budget": [{"block": "lens", "t": 6e-5, "r": 1e-4}, {"block": "noise", "t": 2e-5, "r": 5e-5}],
            "known": {"focal": 5e-4, "centre_px": 0.7, "scale": 1e-3, "bow_m": 1e-4, "arm_m": 2e-4},
            "limit": {
                "error95_t_m": 1e-4, "error95_r_rad": 1e-4, "block_t": "target", "block_r": "lens",
                "known": {"focal": 1e-4, "centre_px": 0.1, "scale": 9e-4, "bow_m": 2e-5},
            },
            "priors": {"lens": "by its maker"},
            "assuming": {"sigma_px": 0.1, "sigma_flange_t": 5e-5, "sigma_flange_r": 5e-5, "placements": 3},
        },
    }  # fmt: skip
    with served(cell.socket, engine):
        done = subject("start", "cone-capture", "--dry-run")
        as_json = subject("start", "cone-capture", "--dry-run", "--json")
    assert done.code == 0
    for told in (
        "0.0 -90.0 0.0", "28.6 elbow", "12 tool", "1: enters keep-out box 'pillar'", "0.150 mm",
        "0.100 mm, most of it by target", "lens: by its maker", "focal length 0.050 %",
        "places of the arm over its joints 0.200 mm", "measure the target over ten squares",
        "Nothing was moved",
    ):  # fmt: skip
        assert told in done.out
    assert json.loads(as_json.out) == engine.plan
    assert engine.asked[0][1].dry_run is True


@pytest.mark.parametrize(
    ("outcome", "verdict", "failure", "code"),
    [
        ("complete", "pass", None, 0),
        ("complete", "warn", None, 0),
        ("complete", "fail", None, 1),
        ("stopped", None, None, 1),
        ("aborted", None, "BOARD_NOT_SEEN", 1),
        ("aborted", None, "DEVICE_LOST", 3),
        ("aborted", None, "ARM_PROTECTIVE_STOP", 1),
        ("aborted", None, "INTERNAL", 5),
    ],
)
def test_start_wait_stays_to_the_end_and_leaves_with_its_exit_code(
    cell: CellOnDisk,
    engine: TalkingEngine,
    subject: CommandLine,
    outcome: str,
    verdict: str | None,
    failure: str | None,
    code: int,
) -> None:
    described = error(failure, "pose 3").as_dict() if failure else None
    if outcome == "complete":
        cell.add_run(7, hand_eye_result(verdict=verdict or "fail"), outcome=outcome)
    with served(cell.socket, engine) as on_loop:

        def end_when_watched() -> None:
            give_up = time.monotonic() + 5
            while not engine.listeners and time.monotonic() < give_up:
                threading.Event().wait(0.01)
            threading.Event().wait(0.3)
            on_loop(lambda: engine.end(outcome, verdict, described))

        ender = threading.Thread(target=end_when_watched)
        ender.start()
        done = subject("start", "cone-capture", "--wait")
        ender.join()
    assert done.code == code
    assert f"Run 7 ended: {outcome}" in done.err
    assert "cellward confirm 458753" in done.err
    assert ("T_flange_camera" in done.out) == (outcome == "complete")
    assert failure is None or ("pose 3" in done.err)


@pytest.mark.parametrize(
    ("refusal", "code"),
    [("BUSY", 4), ("ARGUMENT_INVALID", 2), ("DEVICE_UNREACHABLE", 3), ("MOTION_LATCHED", 4), ("INTERNAL", 5)],
)
def test_a_refused_request_is_one_sentence_with_a_hint_and_its_exit_code(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine, refusal: str, code: int
) -> None:
    engine.refuse = error(refusal, "cone-capture, run 6")
    with served(cell.socket, engine):
        done = subject("start", "cone-capture")
    assert (done.code, done.out) == (code, "")
    assert "cone-capture, run 6" in done.err
    assert engine.refuse.hint in done.err


@pytest.mark.parametrize("command", [("status",), ("halt",), ("start", "x"), ("accept", 1), ("watch",)])
def test_without_a_daemon_the_exit_code_is_3_and_the_socket_is_named(
    cell: CellOnDisk, subject: CommandLine, command: Any
) -> None:
    done = subject(*command)
    assert done.code == 3
    assert str(cell.socket) in done.err


def test_a_parameter_without_an_equals_sign_is_explained(cell: CellOnDisk, subject: CommandLine) -> None:
    done = subject("start", "cone-capture", "-p", "settle")
    assert done.code == 2
    assert "settle_s=0.5" in done.err


def test_watch_prints_a_line_a_change_until_the_daemon_goes(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine
) -> None:
    with served(cell.socket, engine) as on_loop:

        def change() -> None:
            engine.now = RUNNING
            for listener in tuple(engine.listeners):
                listener()

        def play() -> None:
            give_up = time.monotonic() + 5
            while not engine.listeners and time.monotonic() < give_up:
                threading.Event().wait(0.01)
            threading.Event().wait(0.3)
            on_loop(change)
            threading.Event().wait(0.5)
            on_loop(lambda: setattr(engine, "status", lambda: 1 / 0))

        player = threading.Thread(target=play)
        player.start()
        done = subject("watch")
        player.join()
    lines = done.out.splitlines()
    assert [line.split(" | ")[0] for line in lines] == ["IDLE", "HELD"]
    assert done.code == 5


def test_the_decisions_on_results_say_what_is_in_effect(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def accept(result_id: int, who: str, warned: bool = False, why: str = "") -> dict[str, Any]:
        use = "T_flange_camera version 2 is in effect from the next job on."
        return {"id": result_id, "name": "T_flange_camera", "version": 2, "use": use}

    async def rollback(name: str, who: str) -> dict[str, Any]:
        return {"name": name, "version": None}

    monkeypatch.setattr(engine, "accept", accept)
    monkeypatch.setattr(engine, "rollback", rollback)
    with served(cell.socket, engine):
        assert "T_flange_camera version 2 is in effect" in subject("accept", 5).err
        assert "the configured value is in effect" in subject("rollback", "T_flange_camera").err


@pytest.mark.parametrize("fault", [True, False])
def test_a_reset_says_whether_there_was_a_fault(
    cell: CellOnDisk, engine: TalkingEngine, subject: CommandLine, fault: bool
) -> None:
    engine.now = IDLE | {"latched": fault}
    with served(cell.socket, engine):
        done = subject("reset")
    assert ("The fault is reset" in done.err) is fault
    assert ("There was no fault to reset" in done.err) is not fault


@pytest.mark.wire
def test_status_starts_quickly_because_it_imports_no_numbers(cell: CellOnDisk, engine: TalkingEngine) -> None:
    script = (
        "import sys; sys.argv = ['cellward', 'status', '--config', sys.argv[1]]\n"
        "from daemon.cli import main\n"
        "code = main()\n"
        "heavy = {'numpy', 'scipy', 'cv2', 'asyncio', 'pymodbus'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else code)"
    )
    with served(cell.socket, engine):
        done = subprocess.run(
            [sys.executable, "-c", script, str(cell.config)], capture_output=True, text=True, timeout=30
        )
    assert (done.returncode, done.stderr) == (0, "")
    assert "bay-3" in done.stdout


def test_the_daemon_starts_without_what_draws_reports() -> None:
    code = (
        "import sys, daemon.app, daemon.web.views\n"
        "print(sorted({'plotly', 'narwhals', 'procedures.report.write'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "[]\n", done.stderr
