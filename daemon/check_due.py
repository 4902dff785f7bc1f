"""Which calibrations want to be checked again, by age or by runs. It warns; nothing starts by itself."""

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from cell.calibrations import (
    OF_A_TOOL,
    belt_scale,
    kinematics,
    laser_reference,
    time_offset,
    tool_calibration,
)
from cell.clock import Clock
from cell.errors import CellError
from cell.procedure import Procedure
from cell.store.ledger import Ledger
from cell.store.tool_of import ANY_TOOL, ToolOf
from daemon.config import CellConfig
from daemon.config.models import DueAfter
from daemon.tools import tool_names, usual_tool
from daemon.values import ARM_ROLES, CALIBRATIONS, STAMPED_ROLES
from procedures.documents import kind_named

log = logging.getLogger("cellward.health")

LOOK_S = 2.0
HOUR_S = 3600.0


@dataclass(frozen=True)
class Reason:
    """Why a calibration is due: it was ``never`` measured, or its ``age`` (h) or number of ``runs`` is above
    the limit."""

    cause: Literal["never", "age", "runs"]
    value: float | None = None
    limit: float | None = None

    @property
    def text(self) -> str:
        """In words, for the command line and the log."""
        if self.cause == "never":
            return "it was never measured, what is configured is in use"
        if self.cause == "age":
            return f"checked {self.value:.3g} h ago, more than max_age_h = {self.limit:g}"
        return f"{self.value} runs since its last check, more than max_runs = {self.limit}"


class CheckDue:
    """Looks at the ledger now and then, away from the loop; ``found`` is what it saw last."""

    def __init__(
        self,
        config: CellConfig,
        ledger: Ledger,
        jobs: Mapping[str, type[Procedure]],
        clock: Clock,
        wall: Callable[[], float] = time.time,
    ) -> None:
        """``wall``: the time of day, s, as the ledger has it."""
        self._ledger, self._clock, self._wall = ledger, clock, wall
        rules = {sort: getattr(config.check_due, sort) for sort in type(config.check_due).model_fields}
        self._rules: dict[str, DueAfter] = {}  # by name in the ledger
        self._measuring: dict[str, list[str]] = {}  # jobs that measure it
        self._judging: dict[str, list[str]] = {}  # those of them whose passing says that it still holds
        self._of: dict[str, ToolOf] = {}  # the runs that count
        self._asked: dict[str, str | None] = {}  # the tool that a start of these jobs has to name
        for name, sort in calibrations_of(config).items():
            if (rule := rules[sort]) is not None:
                self._rules[name] = rule
                self._measuring[name], self._judging[name] = _jobs_for(sort, jobs)
                self._of[name], self._asked[name] = _tool_of(config, name, self._job(name))
        self.found: list[dict[str, Any]] = []

    @property
    def wanted(self) -> bool:
        """Whether the configuration asks for any."""
        return bool(self._rules)

    def status(self) -> list[dict[str, Any]]:
        """Of each that is due: ``name``, ``why``, its ``Reason``, the ``job`` that measures it (None: no job
        does), and the ``tool`` that a start of it has to name (None: it need not)."""
        return self.found

    async def watch(self) -> None:
        """Look for ever; a ledger that cannot be read leaves what was seen last."""
        while True:
            try:
                self._tell(found := await asyncio.to_thread(self.due))
                self.found = found
            except CellError as exc:
                log.error("which calibrations are due cannot be told: %s", exc)
            await self._clock.sleep(LOOK_S)

    def _tell(self, found: list[dict[str, Any]]) -> None:
        """One log line for each that has become due."""
        known = {entry["name"] for entry in self.found}
        for entry in found:
            if entry["name"] not in known:
                log.warning("%s is due for a check: %s", entry["name"], entry["why"])

    def due(self) -> list[dict[str, Any]]:
        """Those that are due now; blocks on the disk."""
        found = []
        for name, rule in self._rules.items():
            if (reason := self._reason(name, rule)) is not None:
                start = {"job": self._job(name), "tool": self._asked[name]}
                found.append({"name": name, "why": reason.text, **start, **asdict(reason)})
        return found

    def outlook(self) -> list[dict[str, Any]]:
        """Each calibration that has a rule, with its ``job`` and whether it is ``due``; blocks on the disk.

        ``checked`` is when it was checked last (s since 1970; None: never). It is due at ``due_at`` (as that)
        or after ``runs_left`` more runs, whichever is first; None where the rule does not bound it.
        """
        found = []
        for name, rule in self._rules.items():
            since = self._ledger.checked_at(name, self._judging[name], self._of[name])
            due_at = runs_left = None
            if since is not None and rule.max_age_h is not None:
                due_at = since + HOUR_S * rule.max_age_h
            if since is not None and rule.max_runs is not None:
                runs_left = max(rule.max_runs + 1 - self._runs_since(name, since), 0)
            due = self._reason(name, rule) is not None
            standing = {"checked": since, "due_at": due_at, "runs_left": runs_left, "due": due}
            found.append({"name": name, "job": self._job(name), **standing})
        return found

    def _job(self, name: str) -> str | None:
        return next(iter(self._measuring[name]), None)

    def _runs_since(self, name: str, since: float) -> int:
        return self._ledger.runs_since(since, self._measuring[name], self._of[name])

    def _reason(self, name: str, rule: DueAfter) -> Reason | None:
        """Why it is due; None when it is not."""
        since = self._ledger.checked_at(name, self._judging[name], self._of[name])
        if since is None:
            return Reason("never")
        if rule.max_age_h is not None and (age := (self._wall() - since) / HOUR_S) > rule.max_age_h:
            return Reason("age", age, rule.max_age_h)
        if rule.max_runs is not None and (runs := self._runs_since(name, since)) > rule.max_runs:
            return Reason("runs", runs, rule.max_runs)
        return None


def calibrations_of(config: CellConfig) -> dict[str, str]:
    """The calibrations that this cell has: their names in the ledger, and their keys of ``[check_due]``."""
    roles, tools = config.robot.roles(), tool_names(config)
    found = {CALIBRATIONS[role][0]: CALIBRATIONS[role][0] for role in CALIBRATIONS if role in roles}
    if "arm" in roles:
        found |= {tool_calibration(tool): "T_flange_tool" for tool in tools}
    if "beams" in roles:
        found |= {laser_reference(tool): "laser_reference" for tool in tools}
    if "belt" in roles:
        found[belt_scale(roles["belt"])] = "belt"
    found |= {kinematics(roles[role]): "kinematics" for role in ARM_ROLES if role in roles}
    return found | {time_offset(roles[role]): "time_offset_s" for role in STAMPED_ROLES if role in roles}


def _tool_of(config: CellConfig, name: str, job: str | None) -> tuple[ToolOf, str | None]:
    """The runs that count for a calibration, and the tool that ``job`` has to be told to measure it."""
    sort, _, owner = name.partition(".")
    if sort not in OF_A_TOOL:
        return ANY_TOOL, None
    usual, plain = usual_tool(config, job or ""), config.robot.tool.name if config.robot.plain_tool else None
    return ToolOf(owner, unnamed=owner == plain), None if usual and usual.name == owner else owner


def _jobs_for(sort: str, jobs: Mapping[str, type[Procedure]]) -> tuple[list[str], list[str]]:
    """The jobs that measure calibrations of this sort, and of those the ones that judge what is in effect."""
    kinds = {name: kind_named(job.kind, "job") for name, job in jobs.items() if job.kind}
    measuring = sorted(
        (n for n, kind in kinds.items() if sort in kind.measures), key=lambda n: jobs[n].number
    )
    return measuring, [name for name in measuring if kinds[name].judges]
