"""The plan of a run in place of the run: nothing moves, and its folder says that it was one."""

import asyncio
from typing import Any

from cell.errors import CellError
from cell.procedure import Run
from cell.store.runs import RunFolder


async def dry_run(run: Run, folder: RunFolder) -> dict[str, Any]:
    """``run_id`` and ``plan``; a refusal is in the folder's end, too."""
    end: dict[str, Any] = {"outcome": "dry-run", "error": None}
    try:
        plan = await run.procedure.dry_run(run)
        return {"run_id": run.id, "plan": {"kind": run.procedure.kind, **plan}}
    except CellError as refusal:
        end["error"] = refusal.as_dict()
        raise
    finally:
        await asyncio.to_thread(folder.finish, end)
