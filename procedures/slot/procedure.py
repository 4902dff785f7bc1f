"""Job ``slot-insertion``: a part into a slot of a rack or out of it, refused where it will not fit."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from cell.errors import error
from cell.formats.result import Envelope
from cell.procedure import Procedure, Run
from cell.run_values import RunValues
from procedures.hand_eye_in_use import require_hand_eye
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.judging import solve_slot
from procedures.slot.marking import marker_problem
from procedures.slot.session import InsertionRun
from procedures.slot.states import CHECKPOINTS, TRANSITIONS, State


class SlotInsertion(Procedure):
    """Inserts, pulls or replaces a part; proposes nothing."""

    name: ClassVar[str] = "slot-insertion"
    number: ClassVar[int] = 9
    kind: ClassVar[str] = "slot"
    Config = SlotInsertionConfig
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = TRANSITIONS
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS

    config: SlotInsertionConfig

    def uses(self) -> tuple[str, ...]:
        return ("arm", "flange_camera", "gripper")

    def check(self, values: RunValues) -> None:
        for key in ("start_pose", "fetch_pose", "put_down_pose"):
            name = getattr(self.config, key)
            if name is not None and name not in values.poses:
                there = ", ".join(values.poses) or "none"
                raise error("ARGUMENT_INVALID", f"{key} = '{name}' is not in [poses]; there is {there}")
        if why := marker_problem(self.config):
            raise error("ARGUMENT_INVALID", why)
        require_hand_eye(values)

    async def run(self, run: Run) -> None:
        session = InsertionRun(self.config, run)
        await session.take_all()
        await run.enter(State.SOLVE)
        path = await asyncio.to_thread(session.write)
        run.result = await run.worker.call(solve_slot, path)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """The stations by the rack's model, with every check; nothing moves."""
        return (await InsertionRun(self.config, run).plan()).listing

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solve_slot(path)
