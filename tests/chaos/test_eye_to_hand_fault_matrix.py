"""Device-level faults and operators' acts at every state of a check of a fixed camera, on virtual time.

Whatever happens and whenever, also among the targets that the arm is driven to after the answer: the arm ends
at rest, the run has one terminal entry that names the right error, what was measured by then is on disk, an
answer that was there is kept with its arrivals, and nothing is proposed. After the cause is gone and a reset
the next run succeeds.
"""

import asyncio
import json
from collections.abc import Awaitable, Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from calibration.adjustment.target_correction import CONSTANT, NONE, ChosenWay
from cell.procedure import Run
from daemon.config import CellConfig
from fakes.object import run_virtual
from procedures.eye_to_hand.check import EyeToHandCheck, solve_run
from procedures.eye_to_hand.plan import VolumeRequest, plan_volume
from procedures.hand_eye.plan import PlacementPlan
from procedures.hand_eye.states import State
from tests.chaos.matrix import BRISK, Kind, Strike, assert_aborted, covering, in_cells, kind, put_right, short
from tests.kit.check_cell import DRIVING, STEPS, check_cell, config, wanted
from tests.kit.object_cell import PLANNERS, WHO, ObjectCell, no_report

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

JOB = {
    "poses": 10,
    "min_poses": 10,
    "frames_per_pose": 1,
    "settle_s": 0.0,
    "seek_timeout_s": 2.0,
    "max_duration_s": 60.0,
    "retries_per_pose": 0,
    "propose": "camera",
    "accept": {"auto": True},
}
# The states among the targets have this in front; the question is asked while the job is in the state "plan".
THERE = "target "
PROMPT = THERE + "prompt"
BEFORE = [s.value for s in State if s is not State.SEARCH]  # a check has a hand-eye, so it searches for none
AMONG = [THERE + s for s in ("plan", "prompt", "move", "settle", "capture", "return", "solve")]
MOMENTS = [*BEFORE, *AMONG]
EVERYWHERE, TARGETS = set(MOMENTS), set(AMONG)
NO_PICTURE_MORE = {THERE + "return", THERE + "solve"}
LENT_THERE = {THERE + s for s in ("move", "settle", "capture", "return")}
LENT = {"start-pose", "seek", "plan", "move", "settle", "capture", "return"} | LENT_THERE
FIRST = {"prepare", "place"}  # the lease comes
ON_THE_WAY_S = 0.1  # after a move began
OPERATOR = "operator"

KINDS = [
    kind("arm", "protective-stop", "ARM_PROTECTIVE_STOP", EVERYWHERE),
    kind("arm", "emergency-stop", "ARM_EMERGENCY_STOP", EVERYWHERE),
    kind("arm", "local-mode", "ARM_LOCAL_MODE", FIRST | LENT),
    short("arm", "drop", EVERYWHERE),
    short("arm", "silence", EVERYWHERE, duration_s=1.5),
    kind("arm", "silence", "DEVICE_LOST STALE_DATA", EVERYWHERE - {THERE + "solve"}),
    kind("arm", "reboot", "ARM_REBOOTED DEVICE_LOST", EVERYWHERE),
    kind("arm", "script-death", "ARM_SCRIPT_DIED", LENT),
    kind("arm", "child-crash", "CHILD_DIED", LENT),
    kind("arm", "foreign-program", "ARM_PROGRAM_RUNNING", FIRST | LENT),
    kind("arm", "register-in-use", "ARM_REGISTER_CONFLICT", FIRST | LENT),
    kind("arm", "hang", "CALL_TIMEOUT", EVERYWHERE - {"return", THERE + "solve"}),
    short("camera", "drop", EVERYWHERE),
    kind("camera", "silence", "DEVICE_LOST", EVERYWHERE - NO_PICTURE_MORE),
    kind("camera", "freeze", "CAMERA_FAULT", EVERYWHERE - NO_PICTURE_MORE),
    kind(OPERATOR, "abort", "", EVERYWHERE),
    short(OPERATOR, "hold", EVERYWHERE),
]
SHARES = covering(KINDS, BEFORE)  # all pairs: in the long runs
# Among the targets each of these strikes in each state: the poses are those of a run that is taken over.
ALL_THERE = {
    "arm protective-stop",
    "arm silence",
    "arm script-death",
    "arm foreign-program",
    "camera silence",
    "operator abort",
    "operator hold",
}
STRIKE_THERE = [one for one in KINDS if one.label in ALL_THERE]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One plan for all runs, and no cross-validation: which poses are best, and which way corrects best, does
    not matter; what becomes of the run does."""
    known: list[PlacementPlan] = []

    def plan(request: VolumeRequest) -> PlacementPlan:
        if not known:
            known.append(plan_volume(request))
        return deepcopy(known[0])

    monkeypatch.setitem(PLANNERS, plan_volume, plan)
    answers: dict[str, Any] = {}

    def solve(path: Path, targets: Path | None = None) -> Any:
        data = json.loads(path.read_text("utf-8"))
        key = json.dumps([data["observations"], data.get("driven"), targets is None])
        if key not in answers:
            answers[key] = solve_run(path, targets)
        return deepcopy(answers[key])

    monkeypatch.setitem(PLANNERS, solve_run, solve)
    again = classmethod(lambda cls, path, info, recorded: solve(path))
    monkeypatch.setattr(EyeToHandCheck, "solve_again", again)
    chosen = ChosenWay(CONSTANT, {NONE: 2e-4, CONSTANT: 1e-4})
    monkeypatch.setattr("procedures.eye_to_hand.solve.solver._choice", lambda data, found: chosen)


def test_every_kind_strikes_and_every_state_is_struck() -> None:
    assert all(SHARES)
    assert {moment for share in SHARES for moment in share} == set(BEFORE)
    assert len(STRIKE_THERE) == len(ALL_THERE)


@pytest.mark.parametrize("strikes", in_cells(KINDS, SHARES, each=9))
def test_a_fault_ends_a_check_safely_and_the_next_run_succeeds(strikes: list[Strike], tmp_path: Path) -> None:
    strike_checks(strikes, tmp_path)


@pytest.mark.parametrize("strikes", in_cells(STRIKE_THERE, [AMONG] * len(STRIKE_THERE), each=4))
def test_a_fault_among_the_targets_ends_a_check_safely(strikes: list[Strike], tmp_path: Path) -> None:
    strike_checks(strikes, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("strikes", in_cells(KINDS, [MOMENTS] * len(KINDS), each=1))
def test_a_fault_at_any_state_ends_a_check_safely(strikes: list[Strike], tmp_path: Path) -> None:
    strike_checks(strikes, tmp_path)


def strike_checks(strikes: list[Strike], folder: Path) -> None:
    async def main() -> None:
        async with check_cell(brisk(folder)) as cell:
            first = await operated(cell)
            assert_whole(cell, first)
            for fault, moment in strikes:
                await strike(cell, fault, moment, first if moment in TARGETS else None)
            assert_whole(cell, await operated(cell, first))

    run_virtual(main())


def assert_whole(cell: ObjectCell, run_id: int) -> None:
    assert cell.end(run_id)["outcome"] == "complete", cell.end(run_id)
    assert len(cell.notes(run_id, "target seen")) == 2


def brisk(folder: Path) -> CellConfig:
    return config(
        folder, targets=wanted(STEPS[0]), cell={"limits": BRISK, "arm_keys": {"state_period_s": 0.02}}, **JOB
    )


async def strike(cell: ObjectCell, fault: Kind, moment: str, adopt: int | None) -> None:
    where, proposed = f"{fault.label} at {moment}", len(cell.ledger.results())
    struck = act_at(cell, fault, moment)
    run_id = await operated(cell, adopt)
    assert struck, f"the job never was at {moment} for {where}: {cell.end(run_id)}"
    await cell.clock.sleep(0.5)
    assert cell.at_rest(), where
    end = cell.end(run_id)
    if moment not in fault.felt:
        assert end["outcome"] == "complete", (where, end["error"])
    elif fault.device == OPERATOR:
        assert (end["outcome"], end["packml"]) == ("stopped", "STOPPED"), (where, end)
    else:
        assert_aborted(end, fault, where)
    if moment in fault.felt:
        assert len(cell.ledger.results()) == proposed, f"{where}: something was proposed"
    assert_kept(cell, run_id, moment, where)
    assert_stopped(cell, run_id, where)
    await put_right(cell)


def assert_kept(cell: ObjectCell, run_id: int, moment: str, where: str) -> None:
    """What was measured is on disk; an answer that was there is, with each arrival or why there is none."""
    folder = cell.folder(run_id)
    taken = len(cell.notes(run_id, "pose taken")) + sum(n["poses"] for n in cell.notes(run_id, "adopted"))
    capture = folder.path / "capture.json"
    if capture.exists():
        assert len(json.loads(capture.read_text("utf-8"))["observations"]) == taken, where
    result, path = folder.read_result(), folder.path / "axbc.json"
    data = json.loads(path.read_text("utf-8")) if path.exists() else {}
    assert "driven" in data or moment not in TARGETS, where
    if "driven" not in data:  # there was no answer yet
        assert result is None, where
        return
    assert result is not None, where
    answer = result["result"]
    assert len(answer["places"]) == taken == JOB["poses"], where
    driven = answer["driven"]
    (target,) = driven["targets"]
    arrived = {line["how"] for line in data["driven"]["arrivals"]}
    assert {how for how, seen in (("given", "before"), ("corrected", "after")) if target[seen]} == arrived, (
        where
    )
    assert {line["how"] for line in cell.notes(run_id, "target seen")} <= arrived, where
    assert len(arrived) + len(driven["lost"]) == 2, (where, driven["lost"])


def assert_stopped(cell: ObjectCell, run_id: int, where: str) -> None:
    """Every lease ended in a standstill that was measured, or began nothing, or motion is locked."""
    ends = len(cell.notes(run_id, "standstill")) + len(cell.notes(run_id, "nothing begun"))
    open_ends = len(cell.notes(run_id, "lease")) - ends
    assert open_ends == 0 or (open_ends == 1 and cell.engine.status()["latched"]), where


def is_at(moment: str, run: Run) -> bool:
    """Whether the job is there; it solves before its targets and after them."""
    solves = [to.value for _, to in run.visited].count("solve")
    asks = run.prompt is not None and DRIVING in run.prompt[1]
    if moment == PROMPT:
        return asks
    state = None if run.state is None else run.state.value
    among = solves > (1 if state == "solve" else 0)
    return not asks and among == moment.startswith(THERE) and state == moment.removeprefix(THERE)


def act_at(cell: ObjectCell, fault: Kind, moment: str) -> list[str]:
    """Strike once at ``moment``, in a move on its way; the list holds it when that was done."""
    struck = list[str]()
    loop = asyncio.get_running_loop()
    doing: set[asyncio.Task[None]] = set()

    def act() -> None:
        if fault.device != OPERATOR:
            cell.plant.plants[fault.device].inject(fault.fault, fault.arguments)
            return
        task = loop.create_task(ACTS[fault.fault](cell))
        doing.add(task)
        task.add_done_callback(doing.discard)

    def look() -> None:
        run = cell.engine.run
        if struck or not cell.engine.active or run is None or not is_at(moment, run):
            return
        struck.append(moment)
        loop.call_later(ON_THE_WAY_S if moment.endswith(("move", "return")) else 0.0, act)

    cell.engine.subscribe(look)
    return struck


async def hold(cell: ObjectCell) -> None:
    if cell.engine.active:
        cell.engine.hold(WHO)
        await cell.clock.sleep(3.0)
    if cell.engine.active:
        await cell.engine.resume(WHO)


async def abort(cell: ObjectCell) -> None:
    if cell.engine.active:
        await cell.engine.abort(WHO)


ACTS: dict[str, Callable[[ObjectCell], Awaitable[None]]] = {"hold": hold, "abort": abort}


async def operated(cell: ObjectCell, adopt: int | None = None) -> int:
    """A run whose operator confirms what is asked, and finishes where the target cannot be found."""
    run_id = await cell.start(placed=False, adopt=adopt)
    while cell.engine.active:
        run = cell.engine.run
        if run is not None and run.prompt is not None:
            number, text = run.prompt
            await cell.clock.sleep(0.02)  # what strikes at a question finds it open
            if "Or skip the placement" in text:
                await cell.engine.finish(WHO)
            elif cell.engine.active and run.prompt is not None:
                await cell.engine.confirm(number, WHO)
        await cell.clock.sleep(0.05)
    return run_id
