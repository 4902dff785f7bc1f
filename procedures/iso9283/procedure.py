"""Job ``iso9283``: the same poses many times, and where a tracker saw the reflector each time."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from cell.errors import CellError, error
from cell.formats.result import Envelope
from cell.procedure import Procedure, Run
from cell.run_values import RunValues
from cell.to_its_end import run_to_its_end
from procedures.iso9283.config import Iso9283Config
from procedures.iso9283.judging import solve_iso9283
from procedures.iso9283.plan import kinematics_of, point_of
from procedures.iso9283.session import IsoRun
from procedures.iso9283.states import CHECKPOINTS, TRANSITIONS, State
from procedures.trends import keep_trends


class Iso9283Test(Procedure):
    """Measures AP and RP of the arm, with or without its calibrated kinematics; proposes nothing."""

    name: ClassVar[str] = "iso9283"
    number: ClassVar[int] = 11
    kind: ClassVar[str] = "iso9283"
    Config = Iso9283Config
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = TRANSITIONS
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS
    judges_arm: ClassVar[bool] = True

    config: Iso9283Config

    def uses(self) -> tuple[str, ...]:
        return ("arm", "tracker")

    def check(self, values: RunValues) -> None:
        poses = values.poses
        if self.config.near not in poses:
            there = ", ".join(poses) or "none"
            raise error(
                "ARGUMENT_INVALID", f"near = '{self.config.near}' is not in [poses]; there is {there}"
            )
        kinematics_of(values, self.config)
        point_of(values, self.config)

    async def run(self, run: Run) -> None:
        session = IsoRun(self.config, run)
        try:
            await session.take_all()
        except (Exception, asyncio.CancelledError):  # whatever it was, the arrivals are no less good
            await run_to_its_end(_keep_what_is_left(run, session))
            raise
        await run.enter(State.SOLVE, f"{len(session.record.samples)} arrivals")
        path = await asyncio.to_thread(session.write)
        run.note("solve", event="started", samples=len(session.record.samples))
        limits = {"max_AP_m": self.config.max_AP_m, "max_RP_m": self.config.max_RP_m}
        run.result = found = await run.worker.call(solve_iso9283, path, limits)
        how = "corrected" if found.result.corrected else "uncorrected"
        worst = {"AP": found.result.AP_max, "RP": found.result.RP_max}  # RP tells wear, AP a bent arm
        await keep_trends(run, {f"iso9283.{k}_m.{how}.{run.arm().name}": v for k, v in worst.items()})

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every pose with the guard's findings and the order of visits; nothing moves."""
        return (await IsoRun(self.config, run).plan()).listing

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        limits = {key: info["job_config"].get(key) for key in ("max_AP_m", "max_RP_m")}
        return solve_iso9283(path, limits)


async def _keep_what_is_left(run: Run, session: IsoRun) -> None:
    """Write the data set of what was measured, if anything was."""
    if not session.record.samples:
        return
    try:
        await asyncio.to_thread(session.write)
    except CellError as second:  # as a full disk; what ended the run is the reason
        run.note("error", **second.as_dict())
