"""The parts of the demo: its PLC, its children, and its judgement."""

import asyncio
import json
import os
import signal
import socket
import sys
import threading
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest

from calibration.kinematics.families import arm_spec, robot_document
from cell.clock import MonotonicClock
from cell.errors import CellError, catalogue
from cell.formats.result import read_as
from cell.formats.robot import parse_robot
from cell.poses import exp_xi, from_pose6, to_pose6
from cell.store.files import read_json
from daemon.config import ModbusSection, load_config
from daemon.demo import plc as registers
from daemon.demo import wire
from daemon.demo.children import SERVICE_NICE, Child
from daemon.demo.fast import write_config
from daemon.demo.folder import begin_in
from daemon.demo.plc import Plc
from daemon.demo.scenes import OBSERVED_MODEL, STORED_SET, DemoScene, scenes_of
from daemon.demo.steps import STEPS, steps_of
from daemon.demo.wire import _no_socket_left
from daemon.modbus import Command, ModbusFace
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.belt.result import BeltTrackingResult
from procedures.belt.truth import judge_picks
from procedures.beside_truth import SURE_POSE
from procedures.hand_eye.result import ArmError, ArmFromBoard, HandEyeResult
from procedures.hand_eye.truth import judge, judge_corrected, judgement_text
from procedures.registry import JOBS
from procedures.tracker.result import KincalResult
from procedures.tracker.truth import judge_arm
from tests.kit.cli_harness import hand_eye_result
from tests.kit.whole_results import whole


class StandIn:
    """Answers commands and shows a status block of the test's choosing."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.answer = 1
        self.status: dict[str, Any] = {"status": 0}

    async def handle(self, command: Command) -> int:
        self.commands.append(command)
        return self.answer


@contextmanager
def modbus(stand_in: StandIn) -> Iterator[tuple[str, int]]:
    """The real Modbus face in a thread of its own."""
    ready, stop = threading.Event(), asyncio.Event()
    found: list[Any] = []

    async def serve() -> None:
        config = ModbusSection(bind="127.0.0.11:0", allow_write=True, allow_clients=["127.0.0.0/8"])
        face = ModbusFace(
            config, MonotonicClock(), stand_in.handle, lambda: stand_in.status, last_sequence=65535
        )
        await face.start()
        found.extend([asyncio.get_running_loop(), face.address])
        ready.set()
        await stop.wait()
        await face.stop()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert ready.wait(5)
        yield found[1]
    finally:
        found[0].call_soon_threadsafe(stop.set)
        thread.join(10)


@pytest.mark.wire
def test_the_plc_speaks_the_register_map_of_the_daemon() -> None:
    stand_in = StandIn()
    stand_in.status = {
        "status": registers.READY | registers.ARM_OK | registers.CAMERA_OK | registers.BUSY,
        "packml_state": 6, "run_id": 0x12345, "prompt_id": 0x70001, "step": 12, "steps": 60,
        "error_code": 3001,
    }  # fmt: skip
    with modbus(stand_in) as (host, port), Plc(host, port) as subject:
        assert subject.connect()
        subject.command(registers.START, job=1)
        status = subject.command(registers.CONFIRM, argument=0x70001)
    assert status.ready_with(registers.ARM_OK | registers.CAMERA_OK)
    assert not status.ready_with(registers.BEAMS_OK)
    assert (status.busy, status.packml, status.error_code) == (True, 6, 3001)
    assert (status.run_id, status.prompt_id, status.step, status.steps) == (0x12345, 0x70001, 12, 60)
    assert [(c.code, c.job, c.argument_uint32) for c in stand_in.commands] == [(1, 1, 0), (10, 0, 0x70001)]
    assert [c.sequence for c in stand_in.commands] == [1, 2]  # 65535 is followed by 1


@pytest.mark.wire
def test_a_refusal_over_modbus_is_the_error_that_its_number_names() -> None:
    stand_in = StandIn()
    stand_in.answer = 0x8000 | catalogue()["BUSY"].code
    with modbus(stand_in) as (host, port), Plc(host, port) as subject:
        assert subject.connect()
        with pytest.raises(CellError, match="A job is running"):
            subject.command(registers.START, job=1)


@pytest.mark.wire
def test_a_plc_without_a_daemon_does_not_connect_and_raises_when_it_talks() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.11", 0))
        with Plc(*unused.getsockname()) as subject:
            assert not subject.connect()
            with pytest.raises(CellError) as caught:
                subject.poll()
    assert caught.value.name == "DEVICE_LOST"


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


@pytest.mark.wire
def test_a_child_is_gone_after_its_block_also_when_it_ignores_sigterm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.demo.children.TERM_DEADLINE_S", 0.3)
    code = (
        "import signal, subprocess, sys, time\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "grandchild = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        "print(grandchild.pid, flush=True); time.sleep(60)"
    )
    log = tmp_path / "log"
    with Child("stubborn", python(code), log) as subject:
        subject.wait_for(lambda: log.read_text().endswith("\n"), "line", 10)
        pids = [subject.pid, int(log.read_text())]
    gone = psutil.wait_procs([psutil.Process(p) for p in pids if psutil.pid_exists(p)], timeout=5)[1]
    assert gone == []


@pytest.mark.wire
@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="this kernel weighs no sessions")
def test_a_child_of_low_priority_stands_back_from_other_sessions_until_it_is_waited_for(
    tmp_path: Path,
) -> None:
    log = tmp_path / "log"
    command = python("import time; print(open('/proc/self/autogroup').read(), flush=True); time.sleep(60)")
    with Child("objects", command, log, nice=10) as subject:
        subject.wait_for(lambda: "\n" in log.read_text(), "line", 10)
        subject.come_forward()
        later = Path(f"/proc/{subject.pid}/autogroup").read_text()
    assert (log.read_text().split()[-1], later.split()[-1]) == ("10", "0")


@pytest.mark.wire
@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="this kernel weighs no sessions")
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may raise a session's share")
def test_twin_and_daemon_have_the_share_of_their_priority_against_other_sessions(tmp_path: Path) -> None:
    log = tmp_path / "log"
    command = python("import time; print(open('/proc/self/autogroup').read(), flush=True); time.sleep(60)")
    with Child("twin", command, log) as subject:
        subject.wait_for(lambda: "\n" in log.read_text(), "line", 10)
    assert int(log.read_text().split()[-1]) == SERVICE_NICE < 0


@pytest.mark.wire
def test_a_child_that_ends_early_is_reported_with_its_last_words(tmp_path: Path) -> None:
    command = python("import sys; sys.exit('the address is in use')")
    with (
        pytest.raises(CellError, match="the address is in use") as caught,
        Child("twin", command, tmp_path / "log") as subject,
    ):
        subject.wait_for(lambda: False, "cell.toml", 10)
    assert caught.value.name == "CHILD_DIED"


@pytest.mark.wire
def test_a_child_that_is_late_is_said(tmp_path: Path) -> None:
    with (
        pytest.raises(CellError, match=r"no cell.toml in 0.2 s"),
        Child("twin", python("import time; time.sleep(60)"), tmp_path / "log") as subject,
    ):
        subject.wait_for(lambda: False, "cell.toml", 0.2)


@pytest.mark.wire
def test_a_child_does_not_survive_the_kill_of_its_parent(tmp_path: Path) -> None:
    code = (
        "import sys, time, pathlib\n"
        "from daemon.demo.children import Child\n"
        "with Child('c', [sys.executable, '-c', 'import time; time.sleep(60)'], pathlib.Path('log')) as c:\n"
        "    print(c.pid, flush=True); time.sleep(60)"
    )
    log = tmp_path / "parent.log"
    command = ["env", "-C", str(tmp_path), *python(code)]
    with Child("parent", command, log) as parent:
        parent.wait_for(lambda: log.read_text().endswith("\n"), "pid", 20)
        child = psutil.Process(int(log.read_text()))
        os.kill(parent.pid, signal.SIGKILL)
        assert psutil.wait_procs([child], timeout=5)[1] == []


def test_only_sockets_that_nobody_answers_are_taken_away(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as alive, socket.socket(socket.AF_UNIX) as dead:
        alive.bind(str(tmp_path / "alive.sock"))
        alive.listen()
        dead.bind(str(tmp_path / "dead.sock"))
        (tmp_path / "twin.log").touch()
        with _no_socket_left(tmp_path):
            pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["alive.sock", "twin.log"]


def test_what_an_earlier_demo_left_is_kept_under_another_name(tmp_path: Path) -> None:
    for left in ("first", "second"):
        begin_in(tmp_path, "state", "demo")
        (tmp_path / "state").mkdir()
        (tmp_path / "state" / left).touch()
    begin_in(tmp_path, "state", "demo")
    assert sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*")) == [
        "state-1", "state-1/first", "state-2", "state-2/second",
    ]  # fmt: skip


def test_the_judgement_weighs_the_error_with_the_stated_covariance() -> None:
    document = hand_eye_result()
    sigma = np.array([1e-4, 2e-4, 3e-4, 1e-4, 2e-4, 3e-4])
    document["result"]["cov"] = np.diag(sigma**2).tolist()
    document["result"]["T_flange_camera"] = [0.01, -0.08, 0.05, 0.3, -0.2, 0.9]
    result = read_as(HandEyeResult, document)
    xi = sigma * [1.0, -2.0, 0.5, 1.5, 0.0, -1.0]
    found = from_pose6(document["result"]["T_flange_camera"])
    truth = {"T_flange_camera": to_pose6(found * exp_xi(xi)).tolist()}
    subject = judge(result, truth)
    assert subject.m2 == pytest.approx(1 + 4 + 0.25 + 2.25 + 1, rel=1e-6)
    assert subject.good
    text = judgement_text(subject, result.result)
    assert "NOT" not in text
    assert "not resolved" in text
    far = {"T_flange_camera": to_pose6(found * exp_xi(sigma * [5.5, 0, 0, 0, 0, 0])).tolist()}
    assert judge(result, far).m2 > SURE_POSE
    assert "NOT consistent" in judgement_text(judge(result, far), result.result)


def test_a_corrected_arm_is_held_against_the_twins_own() -> None:
    links = {key: [0.0] * 6 for key in ("delta_theta", "delta_d", "delta_a", "delta_alpha")}
    gear = {"name": "gear2.1", "joint": 2, "of": [0, 1, 0, 0, 0, 0], "sin": 1e-4, "cos": 0.0}
    true = {"model": "ur10e", "factory": links, "error": links, "joint_errors": [gear]}
    nominal = {"model": "ur10e"}
    spec = arm_spec(parse_robot(nominal, "robot"))
    found = robot_document(spec, spec.arm, spec.arm.nominal, {}) | {"joint_errors": [gear]}
    stated = ArmFromBoard(
        configured=ArmError(t=6e-5, r=1e-4, t95=1e-4), corrected=ArmError(t=2e-5, r=1e-5, t95=4e-5)
    )
    subject = judge_corrected(stated, found, true, nominal)
    assert subject.good
    before, after = (float(r.split()[3]) for r in subject.text.splitlines() if r.startswith("as c"))
    assert after < 1e-3, "the same arm, mm"
    assert 0.02 < before < 0.1, "0.1 mrad about the shoulder, less what another base does, mm"
    far = judge_corrected(stated, found, true | {"joint_errors": [gear | {"sin": 5e-4}]}, nominal)
    assert not far.good
    assert "the corrected arm is NOT consistent with what is stated of it" in far.text


def test_an_answer_without_a_pose_cannot_be_judged() -> None:
    document = hand_eye_result() | {"reasons": ["parallel-axes: all rotations share one axis"]}
    del document["result"]["T_flange_camera"]
    with pytest.raises(CellError, match="parallel-axes"):
        judge(read_as(HandEyeResult, document), {})


SCENES = scenes_of(steps_of(list(STEPS)))


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.twin)
def test_the_fast_demo_has_the_cell_that_the_twin_would_write(scene: DemoScene, tmp_path: Path) -> None:
    scenario = Scenario.load(scene.prepare(tmp_path))
    subject = tomllib.loads(write_config(scene, tmp_path).read_text("utf-8"))
    assert {d["scenario"] for d in subject["device"].values()} == {scene.prepare(tmp_path)}
    devices = ("arm", "camera", "beams", "tracker", "belt", "gripper", "palletizer")
    written = tomllib.loads(scenario.cell_toml({name: {} for name in devices}, "", ""))
    for section in ("robot", "limits", "poses", "target", "job"):
        assert subject.get(section) == written.get(section)
    assert subject["device"].keys() == written["device"].keys()
    for device, section in subject["device"].items():
        assert section.get("expect_serial") == written["device"][device].get("expect_serial")
    load_config(tmp_path / "fast.toml")
    if scenario.world.observed is not None:
        assert read_json(tmp_path / OBSERVED_MODEL) == scenario.world.observed.robot
    kind = tomllib.loads(write_config(scene, tmp_path, ideal=True).read_text("utf-8"))
    for section in subject["device"].values():
        section["scenario"] += ":ideal"
    if scene.twin == "tracker":  # the stored set is of the arm with gears and sag
        sampling = subject["job"]["tracker-sampling"]
        del sampling["with_set"]
        sampling["poses"] = 40
    assert kind == subject


def test_the_stored_set_is_of_the_arm_and_the_monuments_of_the_demo(tmp_path: Path) -> None:
    """So that nobody changes the twin's truth without measuring the set anew."""
    (scene,) = (scene for scene in SCENES if scene.twin == "tracker")
    world = World.from_scenario(Scenario.load(scene.prepare(tmp_path)))
    assert world.tracker is not None
    truth, data = world.truth(), read_json(tmp_path / STORED_SET)
    stand, sigma = from_pose6(truth["tracker"]["T_base_tracker"]), 40e-6
    for sample in data["samples"]:
        point = truth["tracker"]["reflectors"][sample["target"]]["point"]
        true = stand.inv().apply(world.true.forward(sample["q"]).apply(point))
        assert np.linalg.norm(true - sample["p_tracker"]) < 6 * sigma
    for name, seen in data["notes"]["sampling"]["monument_points"].items():
        true = stand.inv().apply(truth["tracker"]["reflectors"][name]["point"])
        assert np.linalg.norm(true - seen["p_tracker"]) < 6 * sigma


@pytest.mark.parametrize(
    ("job", "last"),
    [
        ("cone-capture", "cone-capture"),
        ("laser-reference", "laser-update"),
        ("belt-calibration", "belt-tracking"),
        ("touch-test", "cross-check"),
    ],
)
def test_a_job_that_is_run_for_another_one_is_shown_with_it(job: str, last: str) -> None:
    assert steps_of([job]) == list(STEPS[last])


def test_every_step_is_of_a_job_that_there_is_with_its_number() -> None:
    for step in steps_of(list(STEPS)):
        if not step.compares:  # no job: its runs are of the steps before it
            assert JOBS[step.job].number == step.number


def picked(count: int) -> BeltTrackingResult:
    document = {"kind": "belt-tracking", "verdict": "pass", "result": {"picks": count}}
    return read_as(BeltTrackingResult, whole(document))


def test_picks_are_good_where_the_gripper_truly_met_every_item() -> None:
    contact = {"off_m": [0.0003, 0.0004], "slide_m_s": 0.001, "taken": True}
    truth = {"belt": {"dir": [1.0, 0.0, 0.0]}, "gripper": {"contacts": [contact] * 10}}
    subject = judge_picks(picked(10), truth, Path())
    assert subject.good
    assert "0.500" in subject.text
    assert not judge_picks(picked(11), truth, Path()).good
    above = {"off_m": None, "slide_m_s": 0.001, "taken": True}  # held by fingers that stopped over its face
    assert judge_picks(picked(11), {**truth, "gripper": {"contacts": [contact] * 10 + [above]}}, Path()).good
    far = {**truth, "gripper": {"contacts": [{**contact, "off_m": [0.002, 0.0]}] * 10}}
    assert not judge_picks(picked(10), far, Path()).good
    assert not judge_picks(picked(0), {**truth, "gripper": {"contacts": []}}, Path()).good


def test_an_arm_is_good_where_it_keeps_its_promise_about_the_truth(tmp_path: Path) -> None:
    links = {key: [0.0] * 6 for key in ("delta_theta", "delta_d", "delta_a", "delta_alpha")}
    reflector = {"on": "arm", "point": [0.0, 0.0, 0.05]}
    place = [0.4, -2.0, 0.3, 0.1, 0.2, 0.3]
    truth: dict[str, Any] = {
        "robot": {"model": "ur10e", "factory": links, "error": links, "joint_errors": []},
        "tracker": {
            "T_base_tracker": place,
            "sigma0_m": 15e-6,
            "sigma_per_m": 6e-6,
            "reflectors": {"smr1": reflector},
        },
    }
    samples = [
        {"q": q, "p_tracker": [1.0, 1.0, 1.0], "target": "smr1"}
        for q in np.random.default_rng(3).uniform(-2.0, 2.0, (20, 6)).tolist()
    ]
    for name in ("kincal.json", "heldout.json"):
        (tmp_path / name).write_text(json.dumps({"samples": samples}))
    answer = {
        "robot": {"model": "ur10e", "tool": {"smr1": reflector["point"]}},
        "T_tracker_base": to_pose6(from_pose6(place).inv()).tolist(),
        "absolute_accuracy": {"predicted_95": 3e-5},
    }
    facts = {"measured": 15, "set_aside": 3, "stored": {"path": "stored.json", "samples": 40}}
    aside = {"set_aside": {"rms": {"registration_only": 0.002}}}
    named = {"kind": "kincal", "verdict": "pass", "result": answer}
    result = read_as(KincalResult, whole({**named, "inputs": {"sampling": facts}, "heldout": aside}))
    subject = judge_arm(result, truth, tmp_path)
    assert subject.good, subject.text
    told = "15 poses of this run, 3 of them set aside, solved together with a stored set of 40"
    assert told in subject.text
    truth["robot"]["error"] = {**links, "delta_a": [0.0, 1e-4, 0.0, 0.0, 0.0, 0.0]}
    subject = judge_arm(result, truth, tmp_path)
    assert not subject.good
    assert "NOT consistent with" in subject.text
    assert "0.1000" in subject.text  # a link that is 0.1 mm longer


@pytest.mark.parametrize(("steps", "told"), [(0, "step 10, "), (12, "step 10 of 12, ")])
def test_a_job_without_an_end_of_its_own_is_told_without_a_number_of_steps(
    steps: int, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Panel:
        left = 2

        def poll(self) -> Any:
            self.left -= 1
            shown = {"run_id": 3, "step": 10, "steps": steps, "picks": 0, "held": False, "prompt_id": 0}
            return SimpleNamespace(busy=self.left > 0, **shown)

        def command(self, *_: Any, **__: Any) -> None:
            pass

    monkeypatch.setattr(wire, "POLL_S", 0.0)
    subject: Any = Panel()
    wire._run_step(subject, steps_of(["cone-capture"])[0], Path(), ())
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ends", "runs", "resets"),
    [
        (["DEVICE_LOST", None], 2, 1),
        (["DEVICE_LOST", "DEVICE_LOST"], 2, 1),
        ([None], 1, 0),
        (["ARM_PROTECTIVE_STOP"], 1, 0),
    ],
)
def test_a_step_that_was_late_is_taken_once_more_and_no_other(
    ends: list[str | None], runs: int, resets: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[int] = []
    codes = [0 if name is None else catalogue()[name].code for name in ends]
    left = iter(enumerate(codes, start=1))

    def run_step(*_: Any) -> Any:
        run_id, code = next(left)
        return SimpleNamespace(run_id=run_id, error_code=code)

    monkeypatch.setattr(wire, "_wait_ready", lambda *_: None)
    monkeypatch.setattr(wire, "_run_step", run_step)
    subject: Any = SimpleNamespace(command=commands.append)
    children: Any = (None, None)
    run_id, _, status = wire._try_step(subject, steps_of(["cone-capture"])[0], Path(), children)
    assert (run_id, status.error_code) == (runs, codes[runs - 1])
    assert commands == [registers.RESET] * resets
