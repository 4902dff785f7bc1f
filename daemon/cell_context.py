"""What a run may touch of the cell: its devices, the arm's motion, and what is kept of results."""

import asyncio
import logging
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, replace
from typing import Any

from cell.clock import Clock
from cell.devices import Arm, Device
from cell.errors import CellError, error
from cell.formats.result import Envelope
from cell.interruptions import InterruptionLimits, Interruptions
from cell.kinds import as_kind
from cell.motion import MotionBroker, MotionLease
from cell.procedure import Proposal, Run, Worker
from cell.store.ledger import Ledger
from cell.time_histogram import TimeHistogram
from daemon.config import CellConfig
from daemon.results import propose_in_mid_run
from daemon.supervisor import Supervisor
from procedures.arm_setup import lease_settings

log = logging.getLogger("cellward.engine")

TREND_POINTS = 200  # of a health number, in a report


@dataclass
class CellContext:
    """What a run may touch; implements :class:`cell.procedure.Cell`."""

    config: CellConfig
    clock: Clock
    worker: Worker
    supervisor: Supervisor
    broker: MotionBroker
    ledger: Ledger
    paused_since: Callable[[float], float] = lambda since: 0.0  # the loop's longest lag since then, s
    lag_into: Callable[[TimeHistogram | None], None] = lambda spread: (
        None
    )  # counts every lag of the loop there

    def device(self, role: str) -> Device:
        return self.supervisor.ready(self._named(role))

    def _named(self, role: str) -> str:
        name = self.config.robot.roles().get(role)
        if name is None:
            raise error("DEVICE_NOT_READY", f"[robot] names no device for the role '{role}'")
        return name

    def interruptions(self, run: Run) -> Interruptions:
        names = [self._named(role) for role in run.procedure.uses()]
        bounds = self.config.supervisor
        return Interruptions(
            self.clock,
            lambda: self.supervisor.back(names),
            run.note,
            run.show_interruption,
            self.paused_since,
            run.released,
            InterruptionLimits(
                within_s=bounds.silence_s,
                in_a_row=bounds.silences_in_a_row,
                in_all=bounds.silences_in_all,
            ),
            run.hold_for if bounds.ask_after_lost_arm else lambda why: None,
        )

    def motion(
        self, run: Run, tool: Mapping[str, Any] | None = None
    ) -> AbstractAsyncContextManager[MotionLease]:
        values = run.values if tool is None else replace(run.values, tool=tool)
        guard, settings, speed = lease_settings(values)
        after = None if tool is None else lease_settings(run.values)[1]
        # The lease itself waits for an arm that is silent for a moment.
        arm = as_kind(self.supervisor.devices[self._named("arm")].device, Arm)
        return self.broker.lease(run.as_modelled(arm), guard, settings, speed, run, after, run.steps_taken)

    async def propose(self, run: Run, proposal: Proposal, result: Envelope) -> int:
        return await propose_in_mid_run(run, self.ledger, proposal, result)

    async def accept(self, run: Run, result_id: int, who: str, *, commit: bool) -> None:
        run.check_record()
        row = await asyncio.to_thread(self.ledger.accept, result_id, who, commit)
        run.note("decision", event="accepted", name=row["name"], result_id=result_id, by=who)

    async def commit(self, run: Run, result_id: int) -> None:
        run.check_record()
        row = await asyncio.to_thread(self.ledger.commit, result_id)
        what = {"name": row["name"], "result_id": result_id, "version": row["version"]}
        try:
            run.note("decision", event="committed", **what)
        except CellError as exc:  # it is in effect all the same, and nobody may think otherwise
            log.error("run %d: committed, but not in the journal (%s): %s", run.id, exc, what)

    async def reject(self, run: Run, result_id: int, why: str) -> None:
        row = await asyncio.to_thread(self.ledger.reject, result_id, f"run {run.id}", why)
        run.note("decision", event="rejected", name=row["name"], result_id=result_id, why=why)

    async def add_trend(self, name: str, value: float) -> list[tuple[float, float]]:
        return await asyncio.to_thread(self._add_trend, name, value)

    async def add_item(self, run: Run, item: int, t: float, outcome: str, detail: Mapping[str, Any]) -> None:
        await asyncio.to_thread(self.ledger.add_item, run.id, item, t, outcome, detail)

    def _add_trend(self, name: str, value: float) -> list[tuple[float, float]]:
        self.ledger.add_trend(name, value)
        return self.ledger.trend(name, TREND_POINTS)
