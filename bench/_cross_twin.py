"""Faults in the twin for the cross check: a cell of objects lives, is struck, and lives again later.

One life takes the capture and the laser reference of when all is well. The cell is then shut down, something
happens to its world or nothing does, and it is started again on what it had kept: its ledger, its runs. The
jobs that are made again run in that second life. What a fault does not touch is measured once for all faults
of a cell: the beams where only the camera was moved, the capture where only the tool was bent.
"""

import contextlib
import copy
import io
import json
import shutil
import tempfile
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from calibration.adjustment.cross_check import LENS_STILL
from calibration.adjustment.lens_terms import moved_camera
from cell.errors import CellError, present
from cell.known_cell import KnownCell
from cell.poses import Array, exp_xi, from_pose6, to_pose6
from cell.store.runs import RunFolder
from daemon.config import CellConfig, load_config
from daemon.demo.fast import STATE
from daemon.rehearsal.objects import rehearsal_of
from daemon.tools import asked_tool
from fakes.likely import likely_scenario
from fakes.object import VirtualClock, run_virtual
from fakes.world.scenario import SCHEMA
from fakes.world.toml_text import to_toml
from procedures.cross_check.result import CrossCheckResult
from procedures.cross_check.solver import check_cell
from procedures.cross_check.truth import judge_change
from procedures.cross_check.words import JOINTS
from tests.kit.object_cell import WHO, ObjectCell, open_cell

CAPTURE, REFERENCE, CHECK, TOUCH = "cone-capture", "laser-reference", "laser-check", "touch-test"
NOW = {CAPTURE: {"accept": {"auto": False}}}  # what is made again is not taken into effect
# When the two lives begin: noise is a function of time, and so none of it comes twice.
FIRST_S, SECOND_S = 1e3, 1e5
ZEROS = ("joint", "base")
NEVER, CANNOT_TELL = "not done", "cannot-tell"
FIRST, SCENARIO = "first", "scenario.toml"


@dataclass(frozen=True)
class Fault:
    """What happens between: ``size`` is m of the tool's point, m and rad of a camera, rad of a zero.

    The zero is that of one of the ``joint``s 2 to 6, in turn, or of the ``base``, joint 1: with a camera on
    the flange it shows in the beams alone, as a bent tool does.
    """

    part: str
    size: float = 0.0

    @property
    def name(self) -> str:
        return f"{self.part} {1e3 * self.size:g}" if self.size else self.part

    @property
    def moves_camera(self) -> bool:
        """Whether a capture differs by it."""
        return self.part in ("camera", *ZEROS)

    @property
    def moves_tool(self) -> bool:
        """Whether the tool in the beams does."""
        return self.part in ("tool", *ZEROS)


UNTOUCHED = Fault("none")
FAULTS: Mapping[str, Sequence[Fault]] = {
    "small": [Fault("tool", 3e-4), Fault("camera", 5e-4), Fault("joint", 5e-4)],
    "usual": [UNTOUCHED, Fault("tool", 7e-4), Fault("camera", 1e-3), Fault("joint", 1e-3)],
    "large": [Fault("tool", 1.5e-3), Fault("camera", 2e-3), Fault("joint", 2e-3)],
    "base": [Fault("base", 1e-3)],
    "touch": [UNTOUCHED, Fault("tool", 1.5e-3), Fault("camera", 1e-3), Fault("joint", 1e-3)],
}


def faults_of(sizes: Sequence[str]) -> list[Fault]:
    """Of these rows of ``FAULTS``."""
    return [fault for size in sizes for fault in FAULTS[size]]


@dataclass(frozen=True)
class Told:
    """One fault of one cell: what the cross check ``named``, and ``right``, what it should have.

    ``sized``: the size that is stated holds the true one, as the demo judges it; None where no part is named.
    ``named`` is ``not done`` where a run before it came to nothing, and ``why`` says so. ``touch``: a touch
    test stood in place of the beams.
    """

    seed: int
    fault: str
    right: str
    named: str
    sized: bool | None
    probable: Mapping[str, float]
    seconds: float
    why: str = ""
    touch: bool = False

    @property
    def good(self) -> bool:
        return self.named == self.right

    @property
    def wrong(self) -> bool:
        """Whether another part is named than the one that changed, or a changed cell is called unchanged."""
        return not self.good and self.named not in (CANNOT_TELL, NEVER)

    def as_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self))


def joint_of(fault: Fault, seed: int) -> int:
    """Whose zero it is, from 0."""
    return 0 if fault.part == "base" else seed % 5 + 1


def right_of(fault: Fault, seed: int) -> str:
    """What the cross check should say of it."""
    if fault.part == "base":
        return CANNOT_TELL
    return f"zero of {JOINTS[joint_of(fault, seed)]}" if fault.part == "joint" else fault.part


def played(seed: int, faults: Sequence[Fault], touch: bool = False) -> list[Told]:
    """All of ``faults`` in the cell drawn by ``seed``; by a ``touch`` test of now in place of the beams."""
    with (
        tempfile.TemporaryDirectory(prefix="cellward-cross-") as name,
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        try:
            cell = _Cell(seed, Path(name))
        except (CellError, _NotDoneError) as failure:
            none = NEVER, None, dict[str, float](), 0.0, str(failure), touch
            return [Told(seed, f.name, right_of(f, seed), *none) for f in faults]
        return [cell.told(fault, touch) for fault in faults]


class _NotDoneError(Exception):
    """A run that the cross check needs came to nothing; in words."""


@dataclass(frozen=True)
class _Done:
    """A run that is over, and the twin's truth after it."""

    run: RunFolder
    truth: Mapping[str, Any]


class _Cell:
    """The cell of the demo's cross check in a twin that is drawn by ``seed`` as a rehearsal draws one, with
    its files in ``folder``. Its board lies elsewhere in the second life, and its lens has drifted."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.seed, self.folder = seed, folder
        config = _config(self._new_folder(FIRST))
        tool = present(asked_tool(config, CAPTURE, None, needed=True), "tool")
        camera = present(rehearsal_of(config, CAPTURE, tool).camera, "camera")
        beams = rehearsal_of(config, REFERENCE, tool).beams
        self.held = present(rehearsal_of(config, TOUCH, tool).held, "touch test")
        known = KnownCell(
            robot=config.robot.robot_spec(),
            tool=tool.section(),
            payload_kg=tool.payload_kg,
            q_start=config.poses["home"],
            camera=replace(camera, looks=[*camera.looks] * 2),
            beams=beams,
        )
        self.world: dict[str, Any] = tomllib.loads(likely_scenario(known, seed))["world"]
        self.rng = np.random.default_rng([seed, 0xC405])
        self.drift = LENS_STILL.sigma() * self.rng.normal(size=len(LENS_STILL.sigma()))
        self.direction = self.rng.normal(size=9)
        self.kept: dict[tuple[str, str], _Done] = {}
        self.then = self._live(FIRST, None, [CAPTURE, REFERENCE])[0]

    def told(self, fault: Fault, touch: bool) -> Told:
        """What the cross check says after ``fault``."""
        began = time.process_time()
        right = right_of(fault, self.seed)
        named, sized, probable, why = NEVER, None, dict[str, float](), ""
        try:
            now = self._measured(fault if fault.moves_camera else UNTOUCHED, CAPTURE)
            if touch:
                tool = self._measured(fault, TOUCH)
                result = check_cell(self.then.run.path, now.run.path, touch=tool.run.path)
            else:
                tool = self._measured(fault if fault.moves_tool else UNTOUCHED, CHECK)
                result = check_cell(self.then.run.path, now.run.path, tool.run.path)
        except (CellError, _NotDoneError) as failure:
            why = str(failure)
        else:
            if isinstance(result, CrossCheckResult):
                answer = result.result
                named = f"zero of {answer.joint}" if answer.part == "joint zero" else answer.part
                truth = {**now.truth, "T_flange_tool": tool.truth["T_flange_tool"]}
                if named == right and right not in (UNTOUCHED.part, CANNOT_TELL):
                    sized = judge_change(result, self.then.truth, truth).good
                probable = dict(answer.probable)
            else:
                why = "; ".join(result.reasons)
        spent = time.process_time() - began
        return Told(self.seed, fault.name, right, named, sized, probable, spent, why, touch)

    def _measured(self, fault: Fault, job: str) -> _Done:
        """``job`` in a second life, after ``fault``."""
        if (job, fault.name) not in self.kept:
            (self.kept[job, fault.name],) = self._live(f"{job} {fault.name}", fault, [job])
        return self.kept[job, fault.name]

    def _bend(self, size: float) -> tuple[Array, Array]:
        """Shift and tilt in a direction of chance; what goes across the tool is by a turn at its flange."""
        shift = size * self.direction[:3] / np.linalg.norm(self.direction[:3])
        return shift, np.array([-shift[1], shift[0], 0.0]) / self.world["tool"]["T_flange_tool"][2]

    def _live(self, name: str, fault: Fault | None, jobs: Sequence[str]) -> list[_Done]:
        """Run ``jobs``; after ``fault``, None: in the first life."""
        folder = self._new_folder(name)
        if fault is not None:
            shutil.copytree(self.folder / FIRST / STATE, folder / STATE)
        (folder / SCENARIO).write_text(to_toml({"schema": SCHEMA, "world": self._world(fault)}), "utf-8")
        config, clock = _config(folder), VirtualClock(FIRST_S if fault is None else SECOND_S)

        async def live() -> list[_Done]:
            async with open_cell(config, clock) as cell:
                world, done = cell.plant.world, []
                if fault is not None:
                    world.intrinsics = moved_camera(world.intrinsics, self.drift)  # it tells the same
                if fault is not None and fault.part == "tool":
                    world.tool.bend(clock.now(), *self._bend(fault.size))
                for job in jobs:
                    params = {} if fault is None else NOW.get(job, {})
                    run_id = await cell.start(job=job, params=params)
                    if job == TOUCH:
                        await self._touch(cell)
                    end = await cell.finished(run_id)
                    if end["outcome"] != "complete":
                        raise _NotDoneError(f"{job}: {(end['error'] or {}).get('text', end['outcome'])}")
                    done.append(_Done(cell.folder(run_id), world.truth(clock.now())))
                return done

        with patch("daemon.results.draw_report", _no_report):
            return run_virtual(live())

    async def _touch(self, cell: ObjectCell) -> None:
        """Bring the tool's point over each corner that the job asks for, as long as it does."""
        last, world, clock = 0, cell.plant.world, cell.clock
        while cell.engine.active:
            run = cell.engine.run
            if run is not None and run.prompt is not None and run.prompt[0] != last:
                last, corner = run.prompt[0], cell.engine.status()["live"]["corner"]
                there = world.bring_over(clock.now(), int(corner), self.held.gauge_m, self.held.hand_m)
                await clock.sleep(there - clock.now())
                await cell.engine.confirm(last, WHO)
            await clock.sleep(0.1)

    def _world(self, fault: Fault | None) -> dict[str, Any]:
        """The world of the first life, or after ``fault``; a tool is bent while it lives."""
        world = copy.deepcopy(self.world)
        if fault is None:
            return {**world, "placement": world["placement"][:1]}
        world["placement"] = world["placement"][1:]
        if fault.part == "camera":
            turn, shift = (v / np.linalg.norm(v) for v in self.direction[3:].reshape(2, 3))
            camera = world["camera"]
            moved = from_pose6(camera["T_flange_camera"]) * exp_xi(fault.size * np.concatenate([shift, turn]))
            camera["T_flange_camera"] = to_pose6(moved).tolist()
        if fault.part in ZEROS:
            zeros = world["arm"]["error"]["delta_theta"]
            zeros[joint_of(fault, self.seed)] += float(np.sign(self.direction[0])) * fault.size
        return world

    def _new_folder(self, name: str) -> Path:
        folder = self.folder / name
        folder.mkdir(exist_ok=True)
        return folder


def cell_text() -> str:
    """The cell's configuration; @FOLDER@ is where its files are. The boards lie where ``home`` shows them."""
    text = files("daemon.demo").joinpath("fast_changed.toml").read_text("utf-8")
    return text.replace('look_pose = "over_board"', 'look_pose = "home"')


def _config(folder: Path) -> CellConfig:
    path = folder / "cell.toml"
    path.write_text(cell_text().replace("@FOLDER@", str(folder)), "utf-8")
    path.chmod(0o600)
    return load_config(path)


def _no_report(*_: object) -> None:
    """A report takes longer to draw than some runs, and nobody reads these."""
