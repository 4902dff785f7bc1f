"""A check of a fixed camera on virtual time that may drive to targets, and its operator."""

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cell.poses import exp_xi, from_pose6, to_pose6
from daemon.config import CellConfig
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.ideal_world import ideal_text
from tests.kit.object_cell import JOB, WHO, ObjectCell, on_disk, open_cell, write_config

CHECK = "eye-to-hand-check"
IDEAL = "hand_eye_to_hand:ideal"
STEPS = ([0.03, 0.02, 0.02], [-0.04, 0.03, 0.05], [0.03, -0.04, 0.04], [-0.03, -0.03, -0.02])  # m
AWAY = [0.0, 0.0, 3.0]  # m along the camera's axis: no arm is so long
BEHIND = [0.0, 0.0, -2.0]
DRIVING = "Confirm to drive there"  # ends the question before the targets


def given_place(off_m: float = 0.0) -> list[float]:
    """C, the flange in the board, of the scenario's first placement; ``off_m`` along its x."""
    placement = Scenario.load(IDEAL).world.placement[0].T_flange_target
    C = from_pose6(placement).inv() * exp_xi([off_m, 0.0, 0.0, 0.0, 0.0, 0.0])
    return [float(v) for v in to_pose6(C)]


def wanted(*steps: list[float]) -> list[list[float]]:
    """The flange in the camera with the arm at home, moved by ``steps`` (m) along the camera's axes."""
    scenario = Scenario.load(IDEAL)
    world = World.from_scenario(scenario)
    home = np.array(scenario.cell.poses["home"], dtype=float)
    at = from_pose6(world.truth()["T_base_camera"]).inv() * world.believed.forward(home)
    return [to_pose6(exp_xi([*step, 0.0, 0.0, 0.0]) * at).tolist() for step in steps]


def config(
    folder: Path,
    *,
    off_m: float = 0.0,
    scenario: str = IDEAL,
    cell: Mapping[str, Any] | None = None,
    **job: Any,
) -> CellConfig:
    """``off_m``: of the target's place as given; ``job`` goes into the section, ``cell`` is what else
    :func:`write_config` takes."""
    section = {
        "target": "board",
        "T_marker_flange": given_place(off_m),
        "start_pose": "home",
        "poses": 20,
        "min_poses": 12,
        "frames_per_pose": 2,
        "settle_s": 0.1,
        "nearest_m": 0.4,
        "farthest_m": 0.7,
        **job,
    }
    return write_config(folder, scenario, jobs={CHECK: section, JOB: None}, **(cell or {}))


def erring_scenario(folder: Path) -> str:
    """The same cell with an arm that is about 2 mm off its drawing."""
    text = ideal_text("hand_eye_to_hand")
    error = Scenario.load("tracker:ideal").world.arm.error.model_dump()
    rows = "\n".join(f"{key} = {list(row)}" for key, row in error.items())
    path = folder / "scenario.toml"
    path.write_text(text.replace("[world.tool]", f"[world.arm.error]\n{rows}\n\n[world.tool]", 1), "utf-8")
    return str(path)


def give_hand_eye(cell: ObjectCell, off_m: float = 0.0, lens: bool = False) -> None:
    """An earlier calibration of the camera: the twin's own pose, ``off_m`` off, and its lens on request."""
    true = from_pose6(cell.plant.world.truth()["T_base_camera"])
    T = [float(v) for v in to_pose6(true * exp_xi([off_m, 0.0, 0.0, 0.0, 0.0, 0.0]))]
    nominal = cell.config.robot.T_base_camera_nominal
    drawn = None if nominal is None else list(nominal)
    found = {"result": {"lens": cell.plant.world.truth()["camera"]}} if lens else {}
    entry = on_disk(cell.ledger.propose, "T_base_camera", T, found, 0, drawn)
    on_disk(cell.ledger.accept, entry, "test")


@asynccontextmanager
async def check_cell(made: CellConfig, off_m: float = 0.0) -> AsyncIterator[ObjectCell]:
    """A cell with a hand-eye to be checked, which is ``off_m`` off."""
    async with open_cell(made, job=CHECK) as cell:
        give_hand_eye(cell, off_m)
        yield cell


async def driven_run(
    cell: ObjectCell,
    answer: str = "confirm",
    *,
    asked_first: Callable[[], Awaitable[None]] | None = None,
    meanwhile: Callable[[int], Awaitable[None]] | None = None,
    adopt: int | None = None,
) -> tuple[int, str]:
    """The run, and what was asked before the targets; ``answer`` is a call of the engine.

    ``asked_first`` is done once with that question open, ``meanwhile`` again and again, with the run.
    """
    run_id = await cell.start(placed=False, adopt=adopt)
    asked = ""
    while cell.engine.active:
        run = cell.engine.run
        if run is not None and run.prompt is not None:
            number, text = run.prompt
            if DRIVING in text and not asked:
                asked = text
                assert cell.at_rest()
                if asked_first is not None:
                    await asked_first()
            if asked and answer in ("finish", "abort"):
                await getattr(cell.engine, answer)(WHO)
            else:
                await getattr(cell.engine, answer if asked else "confirm")(number, WHO)
        if meanwhile is not None:
            await meanwhile(run_id)
        await cell.clock.sleep(0.05)
    return run_id, asked


def once(
    cell: ObjectCell, act: Callable[[str], Awaitable[Any]], *, seen: int = 0, taken: int = 0
) -> Callable[[int], Awaitable[None]]:
    """For ``meanwhile``: ``act`` when so many poses were ``taken`` and targets ``seen``."""
    done: list[bool] = []

    async def look(run_id: int) -> None:
        notes = {event: len(cell.notes(run_id, event)) for event in ("pose taken", "target seen")}
        if not done and cell.engine.active and notes["pose taken"] >= taken and notes["target seen"] >= seen:
            done.append(True)
            await act(WHO)

    return look
