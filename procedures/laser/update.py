"""Job ``laser-update``: measure the tool, propose its new frame, try it, and only then put it into effect.

The proposal is tried by a second scan under a lease that carries the candidate: the same flange path shifted
so that the candidate's point follows the reference's path. Only when the point meets the reference within its
uncertainty is it committed; in every other way out it is rejected, and the old frame stays.
"""

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from calibration.odds import FALSE_ALARM
from cell.calibrations import tool_calibration
from cell.errors import CellError, present
from cell.formats.result import Envelope, Result
from cell.motion import MotionLease
from cell.procedure import FinishRequested, Proposal, Run
from cell.run_values import RunValues
from cell.to_its_end import run_to_its_end
from procedures.laser.check import AgainstReference, known_of, measure, measurement_of, solved_measurement
from procedures.laser.config import LaserUpdateConfig
from procedures.laser.judging import DEG, not_confirmed, why_not, worth_another
from procedures.laser.measurement import (
    Measurement,
    data_header,
    known_reference,
)
from procedures.laser.record import DATA_FILE, SECOND, THIRD, PassRecord
from procedures.laser.result import LaserResult, SecondScan, Update
from procedures.laser.scan import Scan
from procedures.laser.solving import compare_second
from procedures.laser.states import SCAN


class State(StrEnum):
    """A scan, the decision, a second scan, and what came of it."""

    PREPARE = "prepare"
    PLAN = "plan"
    APPROACH = "approach"
    SWEEP = "sweep"
    RETURN = "return"
    DESCEND = "descend"
    BISECT = "bisect"
    MEASURE = "measure"
    LIFT = "lift"
    RETRACT = "retract"
    SOLVE = "solve"
    ASK = "ask"
    VERIFY = "verify"
    COMPARE = "compare"
    COMMIT = "commit"
    REJECT = "reject"


S = State


class LaserUpdate(AgainstReference):
    """Measures the tool against its reference and corrects its frame."""

    name: ClassVar[str] = "laser-update"
    number: ClassVar[int] = 4
    Config = LaserUpdateConfig
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = {
        **SCAN,
        S.RETRACT: frozenset({S.SOLVE, S.COMPARE}),
        S.SOLVE: frozenset({S.ASK, S.VERIFY}),
        S.ASK: frozenset({S.VERIFY, S.REJECT}),
        S.VERIFY: frozenset({S.APPROACH}),
        S.COMPARE: frozenset({S.COMMIT, S.VERIFY, S.REJECT}),
        S.COMMIT: frozenset(),
        S.REJECT: frozenset(),
    }
    decides: ClassVar[bool] = True

    config: LaserUpdateConfig

    async def run(self, run: Run) -> None:
        measurement = measurement_of(run, self.config)
        await measure(run, measurement, self.config, solved_measurement, scans=2)
        found = present(run.result, "result of a measurement")
        if not isinstance(found, LaserResult) or found.verdict == "fail":
            run.note("decision", event="nothing proposed", why="; ".join(found.reasons))
            return
        await _Candidate(self.config, run, measurement, found).decide()

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every move of the first scan with the guard's findings; nothing moves."""
        measurement = measurement_of(run, self.config)
        measurement.check_fixture()
        plan = await measurement.plan()
        again = "once accepted, all of it again with the candidate's point on the same path, checked then"
        return {**plan, "note": f"{plan['note']}; {again}"}

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solved_update(path, RunValues.of(info["values"]), info["job_config"], recorded)


class _Candidate:
    """A measured tool frame on its way to be committed or rejected, never left in between."""

    def __init__(
        self, config: LaserUpdateConfig, run: Run, measurement: Measurement, measured: LaserResult
    ) -> None:
        self.config, self.run, self.measurement = config, run, measurement
        self.measured, self.told = measured, Update()
        self.name = run.values.tool["name"]
        self.tool = {**run.values.tool, "T_flange_tool": measured.result.T_flange_tool}
        self.why = "the run ended before the candidate was confirmed"
        self.open: int | None = None  # the proposal's number until it is decided

    async def decide(self) -> None:
        """The ledger is written to the end even when the run is stopped meanwhile: no decision is half."""
        try:
            await run_to_its_end(self._propose())
            if not await self._accepted():
                return
            await self._verify()
            if not self.why:
                await self.run.enter(S.COMMIT)
                await run_to_its_end(self._commit())
        except CellError as exc:
            self.why = str(exc)
            raise
        finally:
            if self.open is not None:
                await run_to_its_end(self._reject(self.open))

    @property
    def _number(self) -> int:
        """The proposal's, which is open."""
        return present(self.open, "proposal that is open")

    async def _propose(self) -> None:
        proposal = Proposal(tool_calibration(self.name), self.tool["T_flange_tool"], False)
        self.open = await self.run.cell.propose(self.run, proposal, self.measured)

    async def _commit(self) -> None:
        await self.run.cell.commit(self.run, self._number)
        self.open = None
        self._tell(committed=True)

    async def _reject(self, result_id: int) -> None:
        self._tell(committed=False, why=self.why)
        self._keep(not_confirmed(self.measured, self.why))
        await self.run.cell.reject(self.run, result_id, self.why)

    async def _accepted(self) -> bool:
        """By policy, or by the operator: a confirm accepts, everything else rejects."""
        run = self.run
        if self.config.accept.auto and self.measured.verdict == "pass":
            await run.cell.accept(run, self._number, "policy", commit=False)
            self._tell(accepted_by="policy")
            return True
        await run.enter(S.ASK)
        try:
            await run.ask(self._question())
        except FinishRequested:
            await run.enter(S.REJECT)
            self.why = "finished by the operator instead of accepted"
            return False
        await run.cell.accept(run, self._number, "operator", commit=False)
        self._tell(accepted_by="operator")
        return True

    async def _verify(self) -> None:
        """Scan again with the candidate; ``why`` becomes empty when the point meets the reference.

        After a narrow miss once more, and both scans are used together: of many good tools some miss by
        chance, and a wrong frame is told as surely by the two as by the one.
        """
        second = await self._scan_and_compare(SECOND)
        if second is not None and worth_another(second, self.config.max_U_m):
            self.run.note("decision", event="one more scan", why=self.why)
            await self._scan_and_compare(THIRD)
        if self.why:
            await self.run.enter(S.REJECT, self.why)

    async def _scan_and_compare(self, name: str) -> SecondScan | None:
        """One scan with the candidate into the folder ``name``; what it and those before it say, or None."""
        run = self.run
        await run.enter(S.VERIFY, f"{name} scan, with the candidate tool")
        record = PassRecord(run.folder / name)
        scan = self.measurement.scan(record, self.tool)
        await scan.check_clear()
        await self.measurement.plan_and_note(self.tool)
        await self._scan_again(scan)
        await run.enter(S.COMPARE, f"{len(record.passes)} ways")
        reference = known_reference(run.values)
        if not scan.complete:  # its ways are in passes.jsonl
            self.why = f"the {name} scan was finished early"
            return None
        header = data_header(self.measurement, reference)
        await record.write_data_set(run.worker, header, reference["passes"], scan.complete)
        known = {k: reference[k] for k in ("T_flange_tool", "R_base_flange")}
        first, chance = self.measured.result, self.config.false_alarm
        found = await run.worker.call(compare_second, run.folder / DATA_FILE, first, known, chance)
        self._tell(second_scan=found)
        self.why = why_not(found, self.config.max_U_m)
        run.note("decision", event=f"{name} scan", **found.model_dump())
        return found

    async def _scan_again(self, scan: Scan) -> None:
        """Under a lease with the candidate; the result says whose TCP the controller was left with."""
        lease: MotionLease | None = None
        try:
            async with self.run.motion(tool=self.tool) as lease:
                await scan.take(lease)
        finally:
            held = "unknown" if lease is None else "in effect" if lease.tool_given_back else "candidate"
            self._tell(controller_tool=held)

    def _tell(self, **facts: Any) -> None:
        """Into the result's ``inputs``: what was decided, and why."""
        self.told = self.told.changed(**facts)
        self._keep(self.measured.with_inputs(update=self.told))

    def _keep(self, measured: LaserResult) -> None:
        self.measured = self.run.result = measured

    def _question(self) -> str:
        answer = self.measured.result
        U = present(self.measured.uncertainty.U_point_m, "uncertainty of a measurement")
        last = present(answer.against_last, "measurement that was judged")
        dx, dy, dz = (1e3 * v for v in answer.dp_flange)
        turned = "the tilt was not measured"
        if answer.drot_flange is not None:
            tilt = float(np.linalg.norm(answer.drot_flange))
            turned = f"its axis turned by {DEG * tilt:.2f} deg"
        return (
            f"Tool '{self.name}': its point moved by {dx:+.3f}, {dy:+.3f}, {dz:+.3f} mm in the flange since "
            f"the reference, {turned} (95 % uncertainty of the point {1e3 * U:.3f} mm). Against the frame in "
            f"effect it moved by {1e3 * last.shift:.3f} mm and {DEG * last.tilt_rad:.2f} deg. Confirm "
            "to accept the new frame and try it in a second scan; finish or abort to reject it."
        )


def solved_update(
    path: Path, values: RunValues, config: Mapping[str, Any], recorded: Mapping[str, Any]
) -> LaserResult | Result:
    """The result of an update from its data sets, the second scan's included if there is one.

    What a person decided is taken from ``recorded``, the result as the run left it.
    """
    found = solved_measurement(path, known_of(values), config)
    decided = recorded.get("inputs", {}).get("update", {})
    if not isinstance(found, LaserResult) or not decided:
        return found
    why, max_U_m = decided.get("why") or "", config["max_U_m"]
    if (path.parent / SECOND / path.name).exists() and _by_comparison(why, decided, max_U_m):
        chance = config.get("false_alarm", FALSE_ALARM)
        why = why_not(compare_second(path, found.result, known_reference(values), chance), max_U_m)
    return not_confirmed(found, why) if why else found


def _by_comparison(why: str, decided: Mapping[str, Any], max_U_m: float) -> bool:
    """Whether the last scan that was compared decided, and no finish by the operator."""
    compared = decided.get("second_scan")
    return not why or (compared is not None and why == why_not(SecondScan.model_validate(compared), max_U_m))
