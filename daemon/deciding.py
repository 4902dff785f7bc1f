"""What becomes of results and calibrations: accepted, rejected, rolled back, and runs signed."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from cell.errors import CellError
from cell.procedure import Procedure, Run
from cell.store.ledger import Ledger
from cell.store.runs import load_run
from cell.store.signatures import Statement, sign
from daemon.cell_context import CellContext
from daemon.decisions import check_confirmed, check_decidable, require_read, use_of
from daemon.values import tell_configured


class Deciding(Protocol):
    """What decisions need of the engine."""

    context: CellContext
    ledger: Ledger
    runs: Path
    report_wanted: Callable[[Path], None]

    @property
    def jobs(self) -> Mapping[str, type[Procedure]]: ...

    @property
    def running(self) -> Run | None: ...

    def publish(self) -> None: ...


class Decisions:
    """Each is written to the ledger first; the report of its run is then drawn again."""

    def __init__(self, engine: Deciding) -> None:
        self._engine, self._ledger = engine, engine.ledger
        self.waiting: list[dict[str, Any]] = []  # results that somebody has to decide about

    async def look(self) -> None:
        """Read the results that wait for a decision."""
        self.waiting = await asyncio.to_thread(self._ledger.waiting_results)

    async def accept(self, result_id: int, who: str, warned: bool = False, why: str = "") -> dict[str, Any]:
        """Accept a result; ``RESULT_WARNS`` for one with warnings unless ``warned`` says they were read."""
        engine, config = self._engine, self._engine.context.config
        await asyncio.to_thread(check_decidable, self._ledger, engine.running, result_id)
        await asyncio.to_thread(check_confirmed, self._ledger, engine.jobs, result_id)
        require_read(await asyncio.to_thread(self._ledger.result, result_id), warned)
        await asyncio.to_thread(tell_configured, config, self._ledger)
        entry = await asyncio.to_thread(self._ledger.accept, result_id, who, why=why)
        await self._told(entry["run_id"])
        return {**entry, "use": use_of(config, entry["name"], entry["version"])}

    async def reject(self, result_id: int, who: str, why: str) -> dict[str, Any]:
        await asyncio.to_thread(check_decidable, self._ledger, self._engine.running, result_id)
        entry = await asyncio.to_thread(self._ledger.reject, result_id, who, why)
        await self._told(entry["run_id"])
        return entry

    async def rollback(self, name: str, who: str) -> dict[str, Any]:
        """Put the version before into effect again."""
        await asyncio.to_thread(tell_configured, self._engine.context.config, self._ledger)
        before = await asyncio.to_thread(self._ledger.in_effect, name)
        now = await asyncio.to_thread(self._ledger.rollback, name, who)
        if before is not None:
            await self._draw_again(before["run_id"])
        self._engine.publish()
        return now

    async def sign(self, run_id: int, said: Statement, who: str) -> dict[str, Any]:
        run = await asyncio.to_thread(load_run, self._engine.runs, run_id)
        signature = await asyncio.to_thread(sign, run, said, who)
        self._engine.report_wanted(run.path)
        return asdict(signature)

    async def acknowledge_ledger(self) -> dict[str, Any]:
        return await asyncio.to_thread(self._ledger.acknowledge_damage)

    async def _told(self, run_id: int) -> None:
        await self._draw_again(run_id)
        await self.look()
        self._engine.publish()

    async def _draw_again(self, run_id: int) -> None:
        """A report tells what became of the result; a run that is gone has none."""
        with suppress(CellError):
            run = await asyncio.to_thread(load_run, self._engine.runs, run_id)
            self._engine.report_wanted(run.path)
