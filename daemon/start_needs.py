"""What a start needs before its run is made: procedure, tool, devices and values; refused with the reason."""

import asyncio
from collections.abc import Mapping
from typing import Any

from cell.devices import Arm
from cell.errors import CellError, error
from cell.kinds import as_kind
from cell.procedure import Procedure
from cell.run_values import RunValues
from cell.store.ledger import Ledger
from daemon.cell_context import CellContext
from daemon.controller_limits import told_by
from daemon.job_config import make_procedure
from daemon.movable import require_movable
from daemon.recipes import arguments_of_recipe, place_of, with_recipe
from daemon.run_origin import origin
from daemon.start_request import StartRequest
from daemon.tools import ARGUMENT, CellTool, asked_tool, loaded_tool
from daemon.values import recorded, resolve_values, with_arm_model, with_limits


class StartNeeds:
    """What the jobs of a cell need, as it is now. Nothing moves, and nothing is written."""

    def __init__(self, context: CellContext, ledger: Ledger, jobs: Mapping[str, type[Procedure]]) -> None:
        self._context, self._ledger, self.jobs = context, ledger, jobs

    def procedure(self, job: str, params: Mapping[str, str], recipe: Mapping[str, Any]) -> Procedure:
        """The job with its configuration; ``UNKNOWN_JOB`` names those that there are."""
        cls, config = self.jobs.get(job), self._context.config
        if cls is None:
            known = ", ".join([*sorted(self.jobs), *config.recipe])
            raise error("UNKNOWN_JOB", f"'{job}'; there is {known}")
        return make_procedure(cls, config, params, recipe)

    def tool(self, procedure: Procedure, asked: str | None, moves: bool = True) -> CellTool | None:
        """The tool that a start asks for; one that ``moves`` the arm has to know what is on the flange."""
        chosen = loaded_tool if moves else asked_tool
        return chosen(self._context.config, procedure.name, asked, "arm" in procedure.uses())

    async def devices(self, procedure: Procedure, patience_s: float = 0.0) -> list[str]:
        """Names of the devices the job uses; refused unless all are READY.

        A program of the robot's own that asks for a job as its last act has ``patience_s`` to end.
        """
        context = self._context
        names = [context.device(role).name for role in procedure.uses()]
        if "arm" in procedure.uses():
            await require_movable(as_kind(context.device("arm"), Arm), context.clock, patience_s)
        return names

    async def values(self, procedure: Procedure, tool: CellTool | None, recipe: str) -> RunValues:
        """The values that the job works with now; refused where they cannot be used."""
        config, supervisor, roles = self._context.config, self._context.supervisor, procedure.uses()
        asked = config, self._ledger, supervisor, roles, tool, procedure.reads_reference
        values = await asyncio.to_thread(resolve_values, *asked)
        place = place_of(config, recipe, procedure.name, "limits")
        values = with_limits(values, procedure, told_by(config, supervisor), place)
        values = with_arm_model(values, procedure, config, supervisor)
        procedure.check(values)
        return values

    async def conditions(
        self, request: StartRequest, procedure: Procedure, values: RunValues, devices: list[str]
    ) -> dict[str, Any]:
        """What ``run.json`` keeps of how the run began."""
        config = self._context.config
        entries = ((name, self._context.supervisor.devices[name].identity) for name in devices)
        return {
            "config": config.part_of_a_run(),
            "parameters": dict(request.params),
            "recipe": request.recipe or None,
            "job_config": procedure.config.model_dump(mode="json"),
            "values": recorded(values),
            "identities": {n: {"model": i.model, "serial": i.serial} for n, i in entries if i is not None},
            **await asyncio.to_thread(origin, config, request),
        }

    async def obstacle(self, name: str, tool: str | None = None) -> CellError | None:
        """Why a start of this job or recipe with this tool would be refused now, as far as it is seen
        unplanned."""
        try:
            config = self._context.config
            request = with_recipe(config, StartRequest(name, {}, "", ""))
            recipe = arguments_of_recipe(config, request)
            await self.devices(procedure := self.procedure(request.job, {}, recipe))
            on_flange = self.tool(procedure, tool or recipe.get(ARGUMENT))
            await self.values(procedure, on_flange, request.recipe)
            return None
        except CellError as refusal:
            return refusal
