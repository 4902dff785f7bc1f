"""What is told of a fault that somebody put into a cell, and what truly came of it."""

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import CellError
from daemon.config import CellConfig, load_config
from daemon.demo.ending import beside_truth
from daemon.predictions import found_in, predictions
from fakes.object import run_virtual
from fakes.world.toml_text import to_toml
from procedures.beside_truth import limit_of_worst
from tests.kit.contacts_stated import calibrate, contacts_of
from tests.kit.ideal_world import shipped_text
from tests.kit.laser_cell import laser_cell, laser_config
from tests.kit.object_cell import ObjectCell, open_cell
from tests.kit.picking_cell import JOB, picking_config
from tests.kit.picking_truth import counted, truth_of

Sections = Mapping[str, Mapping[str, Any]]
Injection = Callable[[ObjectCell], None]
FOLLOWING = "descend"  # the state in which the tool goes down with an item
REFUSED = "refused"
_FILE = re.compile(r"^\S+\.toml(:\d+)?: ")
_LIMIT_S = 60.0


@dataclass(frozen=True)
class Claim:
    """How far a figure of the result truly was off, in units of the 95 % limit that is stated for it."""

    of95: float
    off_m: float | None = None


@dataclass(frozen=True)
class Told:
    """``checked`` are findings of ``cellward check``, ``code`` names the error that ended or refused the job,
    ``warned`` are the codes of a result's warnings.

    The job says that ``picked`` items were picked, and the world's gripper has ``taken`` so many.
    """

    checked: Sequence[str] = ()
    outcome: str = ""
    code: str | None = None
    warned: Sequence[str] = ()
    picked: int = 0
    taken: int = 0
    claims: Sequence[Claim] = ()
    at_rest: bool = True

    @property
    def true(self) -> bool:
        """Nothing was claimed that is not so: picks are picks (one that was held when the job ended is lost),
        and no more claims are beyond their 95 %, and none further, than chance lets a few be."""
        beyond, n = sum(claim.of95 > 1.0 for claim in self.claims), len(self.claims)
        if n and max(claim.of95 for claim in self.claims) > limit_of_worst(n, degrees=2, sure=True):
            return False
        return self.picked <= self.taken <= self.picked + 1 and beyond <= 0.05 * n + 1

    @property
    def truth(self) -> str:
        """``true`` in a few words."""
        parts = [] if not self.picked and not self.taken else [f"{self.picked} picked, {self.taken} taken"]
        offs = [claim.off_m for claim in self.claims if claim.off_m is not None]
        if offs:
            within = sum(claim.of95 <= 1.0 for claim in self.claims)
            parts.append(
                f"contacts {1e3 * max(offs):.2f} mm off at most, {within} of {len(offs)} in their 95 %"
                f" ({max(claim.of95 for claim in self.claims):.2f} of it at most)"
            )
        elif self.claims:
            parts.append(f"off by {max(claim.of95 for claim in self.claims):.2f} of the stated 95 %")
        return "; ".join(parts) or "nothing claimed"


@dataclass(frozen=True)
class Wanted:
    """What a fault has to be told by: words in a finding of ``check``, the error that ends the job, or a
    warning of its result. Without an error the job completes.

    Nothing finds a fault that is ``counted``: what every run of such a cell states of contacts has room
    for it."""

    check: str | None = None
    code: str | None = None
    warning: str | None = None
    counted: bool = False
    unconfirmed: bool = False  # picks that the result itself calls so may be none

    def met(self, told: Told) -> bool:
        """Whether it was told so, and nothing false was claimed."""
        if self.check is not None and self.finding(told) is None:
            return False
        if self.counted and not told.claims:
            return False
        if self.code is None:
            ended = told.outcome == "complete"
        else:
            ended = told.outcome in ("aborted", REFUSED) and told.code == self.code and told.at_rest
        warned = self.warning is None or self.warning in told.warned
        return ended and warned and (told.true or self.unconfirmed)

    def finding(self, told: Told) -> str | None:
        """The one that tells of the fault."""
        return next((text for text in told.checked if self.check is not None and self.check in text), None)


@dataclass(frozen=True)
class Row:
    """A fault, where it was put in, what is wanted of it, and how it is played."""

    fault: str
    where: str
    wanted: Wanted
    play: Callable[[Path], Told]
    long: bool = False  # takes more than a few seconds of a computer


def check(config: CellConfig, sections: Sections | None = None) -> list[str]:
    """What ``cellward check`` finds in the cell, with ``sections`` of real devices in place of the twin's."""
    tables = tomllib.loads(Path(config.source).read_text("utf-8"))
    for name, section in (sections or {}).items():
        tables["device"][name] = dict(section)
    path = Path(config.source).with_name("as-real.toml")
    path.write_text(to_toml(tables), "utf-8")
    path.chmod(0o600)
    loaded = load_config(path)
    expected = predictions(loaded)
    found = [*loaded.problems, *loaded.warnings]
    found += [text for kind in ("problems", "cautions") for text in found_in(expected, kind)]
    return [_FILE.sub("", text) for text in found]


def inject(device: str, kind: str, **arguments: Any) -> Injection:
    return lambda cell: cell.plant.plant(device).inject(kind, arguments)


def picking(
    folder: Path,
    *,
    job: Mapping[str, Any] | None = None,
    world: Mapping[str, str] | None = None,
    gripper: Mapping[str, Any] | None = None,
    before: Injection | None = None,
    following: Injection | None = None,
    sections: Sections | None = None,
    picks: int = 4,
) -> Told:
    """Picking in the shipped, real world with lines of ``world`` in it, camera and belt calibrated.

    A fault is injected ``before`` the start, or while the tool is ``following`` an item. ``sections`` are
    those that ``check`` sees."""
    job = {"picks": picks, **(job or {})}
    config = picking_config(folder, job, world, real=True, gripper=gripper)
    checked = check(config, sections)
    out: list[Told] = []

    async def scene() -> None:
        async with open_cell(config, None, JOB) as cell:
            calibrate(cell, np.zeros(6))
            if before is not None:
                before(cell)
                await cell.clock.sleep(0.1)
            try:
                run_id = await cell.start()
            except CellError as exc:
                out.append(Told(checked, REFUSED, exc.name, at_rest=cell.at_rest()))
                return
            if following is not None:
                await cell.until_state(FOLLOWING)
                following(cell)
            give_up = cell.clock.now() + _LIMIT_S
            while cell.engine.active and cell.clock.now() < give_up:
                await cell.clock.sleep(0.1)
            if cell.engine.active:
                await cell.engine.finish("bench")
            end = await cell.finished(run_id)
            done = end["outcome"] == "complete"
            off = [(float(np.linalg.norm(c.off)), c.r95_m) for c in contacts_of(cell, run_id)]
            out.append(
                Told(
                    checked,
                    end["outcome"],
                    end["error"]["name"] if end["error"] else None,
                    [w["code"] for w in cell.result(run_id)["warnings"]] if done else [],
                    counted(cell, run_id)["picked"],
                    len(truth_of(cell).taken),
                    [Claim(one / limit, one) for one, limit in off],
                    cell.at_rest(),
                )
            )

    run_virtual(scene())
    return out[0]


def crossing_beams(folder: Path, filter_s: float, sections: Sections, **job: Any) -> Told:
    """The laser's reference with a filter of ``filter_s`` in the module that reads the beams."""
    text = shipped_text("laser").replace("filter_s = 0.001", f"filter_s = {filter_s}")
    path = folder / "scenario.toml"
    path.write_text(text, "utf-8")
    config = laser_config(folder, job, scenario=str(path), quick=False)
    checked = check(config, sections)
    out: list[Told] = []

    async def scene() -> None:
        async with laser_cell(config, "laser-reference") as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            claims, warned = list[Claim](), list[str]()
            if end["outcome"] == "complete":
                result = cell.result(run_id)
                judged = beside_truth(result, cell.plant.world.truth(), cell.folder(run_id).path)
                claims = [Claim(of95) for of95 in judged.of95.values()]
                warned = [w["code"] for w in result["warnings"]]
            name = end["error"]["name"] if end["error"] else None
            out.append(Told(checked, end["outcome"], name, warned, claims=claims, at_rest=cell.at_rest()))

    run_virtual(scene())
    return out[0]
