"""The untouched files that ``bench.mutations`` damages, and the command that reads each."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench.intercept import make as intercept_scene
from procedures.hand_eye.solve.solver import solve_hand_eye
from tests.kit import hand_eye_scene, kincal_scene, laser_scene
from tests.kit.cli_harness import CellOnDisk

Answer = Callable[[str, str], str | None]
_FAR_M = 0.02  # a passing hand-eye answer further off than this is nonsense


@dataclass(frozen=True)
class Case:
    """A kind: the ``files`` of ``folder`` that are damaged, and the command line that reads them there.

    ``by_value`` is the share of mutations that change a value and not bytes; ``answer`` compares what was
    printed for the untouched and for the mutated files, and says what is grossly off.
    """

    name: str
    folder: Path
    files: tuple[str, ...]
    words: Callable[[Path], tuple[str, ...]]
    by_value: float = 0.8
    answer: Answer | None = None

    def config(self, folder: Path) -> Path:
        """The configuration that the command is given."""
        return folder / "cell.toml"


def cases(folder: Path, names: tuple[str, ...] = ()) -> list[Case]:
    """All kinds, or those in ``names``, written below ``folder``."""
    made = {
        "configuration": _configs,
        "hand-eye": _hand_eye,
        "hand-eye images": _images,
        "kincal": _kincal,
        "ROBOT": _robot,
        "laser": _laser,
        "intercept": _intercept,
        "run": _runs,
    }
    wanted = {name.partition(":")[0] for name in names} or set(made)
    found = [case for name in made if name in wanted for case in made[name](folder / name)]
    return [case for case in found if not names or case.name in names]


def _solve(kind: str, *more: str) -> Callable[[Path], tuple[str, ...]]:
    return lambda folder: (
        "solve",
        kind,
        str(folder),
        *(str(folder / m) if "." in m else m for m in more),
        "--json",
    )


def _configs(folder: Path) -> list[Case]:
    """The shipped configuration."""
    folder.mkdir(parents=True)
    shipped = Path(__file__).parents[1] / "deploy" / "cell.toml"
    (folder / "cell.toml").write_text(shipped.read_text("utf-8"), "utf-8")
    return [Case("configuration", folder, ("cell.toml",), lambda _: ("check", "--json"))]


def _hand_eye(folder: Path) -> list[Case]:
    folder.mkdir(parents=True)
    hand_eye_scene.make_scene(1, count=8).write(folder)
    return [Case("hand-eye", folder, ("capture.json",), _solve("hand-eye"), answer=_pose_far)]


def _images(folder: Path) -> list[Case]:
    """Observations with images; what is in them does not matter to the file system."""
    folder.mkdir(parents=True)
    data = hand_eye_scene.make_scene(1, count=8).data_set()
    grey = np.full((800, 1280), 128, np.uint8)
    for k, name in enumerate(("a.png", "b.jpg", "c.bmp", "d.tiff")):
        cv2.imwrite(str(folder / name), grey)
        del data["observations"][k]["corners"]
        data["observations"][k]["image"] = name
    (folder / "capture.json").write_text(json.dumps(data), "utf-8")
    names = ("a.png", "b.jpg", "c.bmp", "d.tiff", "capture.json")
    return [Case("hand-eye images", folder, names, _solve("hand-eye"), 0.3, _pose_far)]


def _kincal(folder: Path) -> list[Case]:
    folder.mkdir(parents=True)
    kincal_scene.make_scene("ur10e", 1, 40).write(folder)
    return [Case("kincal", folder, ("kincal.json",), _solve("kincal"))]


def _robot(folder: Path) -> list[Case]:
    folder.mkdir(parents=True)
    scene = kincal_scene.make_scene("palletizer", 1, 40)
    (folder / "robot.json").write_text(json.dumps(scene.data["robot"]), "utf-8")
    scene.changed(robot=None).write(folder)
    return [Case("ROBOT", folder, ("robot.json",), _solve("kincal", "--robot", "robot.json"))]


def _laser(folder: Path) -> list[Case]:
    folder.mkdir(parents=True)
    bench = laser_scene.Bench(seed=1, shift=(0.0012, -0.0007, 0.0005))
    laser_scene.write(folder, laser_scene.data_set(bench, depths=(0.006, 0.031), pairs=2, resolution=1e-3))
    return [Case("laser", folder, ("laser.json",), _solve("laser"))]


def _intercept(folder: Path) -> list[Case]:
    folder.mkdir(parents=True)
    data = intercept_scene("wrap", 3, seconds=6.0, queries=4).data
    (folder / "intercept.json").write_text(json.dumps(data), "utf-8")
    return [Case("intercept", folder, ("intercept.json",), _solve("intercept"))]


def _runs(folder: Path) -> list[Case]:
    """Two runs of a capture, read again by every command that does."""
    folder.mkdir(parents=True)
    cell = CellOnDisk(folder)
    names = []
    for number in (1, 2):
        run = cell.add_run(number, None, outcome="complete", verdict="pass", error=None)
        hand_eye_scene.make_scene(number, count=8).write(run.path)
        run.write_result(solve_hand_eye(run.path).as_json())
        names.append(run.path.relative_to(folder))
    files = tuple(
        str(names[1] / n) for n in ("run.json", "journal.jsonl", "end.json", "result.json", "capture.json")
    )

    def words(*told: str) -> Callable[[Path], tuple[str, ...]]:
        def here(copy: Path) -> tuple[str, ...]:
            (copy / "cell.toml").write_text(f'schema = 1\n[cell]\nstate_dir = "{copy / "state"}"\n', "utf-8")
            return told

        return here

    commands = {
        "show": ("show", "2"),
        "show --json": ("show", "2", "--json"),
        "report": ("report", "2", "--rebuild"),
        "replay": ("replay", "2"),
        "compare": ("compare", "1", "2"),
        "runs": ("runs",),
    }
    found = [Case(f"run: {name}", folder, files, words(*told)) for name, told in commands.items()]
    result = str(names[1] / "result.json")

    def export(copy: Path) -> tuple[str, ...]:
        return ("export", str(copy / result), "--format", "ros")

    return [*found, Case("run: export", folder, (result,), export)]


def _pose_far(untouched: str, mutated: str) -> str | None:
    """Whether a passing hand-eye answer lies centimetres from the untouched one."""
    documents: list[dict[str, Any]] = [json.loads(text) for text in (untouched, mutated)]
    poses = [(d.get("result") or {}).get("T_flange_camera") for d in documents]
    before, after = poses
    if before is None or after is None or documents[1]["verdict"] != "pass":
        return None
    off = float(np.linalg.norm(np.subtract(after[:3], before[:3])))
    return f"passes {1e3 * off:.0f} mm off" if off > _FAR_M else None
