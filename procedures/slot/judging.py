"""From the data set to the result: the slot by its pictures, the budget, the verdict. For job and replay."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.slot.arm_errors import ArmErrors, arm_errors
from calibration.slot.budget import Budget, Geometry, Sources, error_budget
from calibration.slot.opening import FoundOpening
from calibration.slot.rectangle import Rectangle
from cell.errors import present
from cell.formats.result import Result, Verdict, Warning_
from cell.poses import Array, from_pose6, log_xi, to_pose6
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.data import BudgetShare, InsertionOutcome, LookTaken, SlotData, read_data_set
from procedures.slot.marking import marker_of
from procedures.slot.result import (
    BudgetRow,
    Correction,
    SlotAnswer,
    SlotBudget,
    SlotInputs,
    SlotObservability,
    SlotResiduals,
    SlotResult,
    SlotUncertainty,
)
from procedures.slot.seeing import seen, seen_by_marker
from procedures.slot.states import PartState
from procedures.slot.stations import along
from procedures.words import mm

BOARD, CAMERA, PART, DIRECTION, DETECTION, MARKER = (
    "board", "hand-eye", "part in the gripper", "rack direction", "detection", "marker beside the slot",
)  # fmt: skip
_TARGET_BLOCK = "target"  # of a hand-eye budget: what the board is not known to
_TILT = [3, 4]
_UNCONFIRMED = Warning_(
    code="slot.unconfirmed",
    text="nothing confirms what the gripper holds: its fingers may have closed on nothing, and then no part "
    "was moved; wire a sensor in the fingers or a vacuum switch, and give it as confirm",
)


@dataclass(frozen=True)
class MeasuredSlot:
    """The slot as the look has it, and the error that an insertion there will have; no budget for a pull."""

    found: FoundOpening
    T_base_slot: RigidTransform
    budget: SlotBudget | None
    arm: ArmErrors


def rectangle_of(config: SlotInsertionConfig, what: str) -> tuple[Rectangle, float]:
    """The size of what a look looks for, and how deep in the slot that is; a part's back stands out."""
    if what == "part":
        part = config.part
        return Rectangle(part.width_m, part.height_m), config.opening.depth_m - part.length_m
    return Rectangle(config.opening.width_m, config.opening.height_m), 0.0


def measure(data: SlotData, look: LookTaken, folder: Path) -> MeasuredSlot:
    """``OPENING_NOT_SEEN`` when the pictures do not tell."""
    config = data.config()
    marker, taken = marker_of(config), look.look(folder)
    found = seen(taken, *rectangle_of(config, look.what)) if marker is None else seen_by_marker(taken, marker)
    q = np.array([look.q, data.insert_q or look.q])
    arm = arm_errors(data.arm(), q, data.arm_rms_m)
    T_base_slot = from_pose6(look.T_base_camera) * found.T_camera
    budget = _budget(data, config, found, arm) if look.what == "opening" else None
    return MeasuredSlot(found, T_base_slot, budget, arm)


def _budget(data: SlotData, config: SlotInsertionConfig, found: FoundOpening, arm: ArmErrors) -> SlotBudget:
    part, known = config.part, data.hand_eye
    repeat = np.diag([config.arm_repeatability_m**2] * 3 + [0.0] * 3)
    direction, rest = _split(found.cov)
    by_marker = {} if found.by_marker is None else {MARKER: found.by_marker}
    share = _board_share(known.budget)
    cov = np.array(known.cov)
    sources = Sources(
        camera={BOARD: share * cov, CAMERA: (1.0 - share) * cov},
        part={PART: np.diag([part.sigma_m**2] * 3 + [part.sigma_rad**2] * 3)},
        detection={DIRECTION: direction, DETECTION: rest, **by_marker},
        arm_look=arm.columns[0],
        arm_insert=arm.columns[1],
        arm=arm.cov,
        repeat=repeat,
    )

    def at(depth_m: float) -> Budget:
        X, P = from_pose6(known.T_flange_camera), from_pose6(data.T_flange_part)
        return error_budget(Geometry(X, found.T_camera, P, along(depth_m)), sources)

    mouth, end = at(0.0), at(config.opening.depth_m)
    worse = max(mouth, end, key=lambda budget: budget.predicted_95)
    return SlotBudget(
        predicted_95_m=worse.predicted_95,
        at_mouth_m=mouth.predicted_95,
        at_end_m=end.predicted_95,
        clearance_m=config.clearance_m,
        by_source=[BudgetRow(source=name, error95_m=size) for name, size in worse.told().items()],
    )


def _split(cov: Array) -> tuple[Array, Array]:
    """What the slot's unknown direction does to its pose (6, 6), and what is left when that is known."""
    gain = cov[:, _TILT] @ np.linalg.inv(cov[np.ix_(_TILT, _TILT)])
    direction = gain @ cov[np.ix_(_TILT, _TILT)] @ gain.T
    return direction, cov - direction


def _board_share(budget: list[BudgetShare]) -> float:
    """What of the variance of a hand-eye's place its target is to blame for."""
    squares = {row.block: row.t**2 for row in budget}
    total = sum(squares.values())
    return squares.get(_TARGET_BLOCK, 0.0) / total if total > 0.0 else 0.0


def refusal(budget: SlotBudget) -> str | None:
    """Why a part is not put in, by the largest causes; None when it will fit."""
    if budget.predicted_95_m <= budget.clearance_m:
        return None
    largest = ", ".join(f"{row.source} {mm(row.error95_m)}" for row in budget.by_source[:3])
    return (
        f"clearance: the part will be up to {mm(budget.predicted_95_m)} (95 %) beside the middle of the "
        f"slot, and {mm(budget.clearance_m)} is free; most of it by {largest}"
    )


def _wanted(config: SlotInsertionConfig) -> PartState:
    """The part's state at the end of a job that went well."""
    keeps = config.action == "pull" and config.put_down_pose is None
    return PartState.GRIPPED if keeps else PartState.RELEASED


def solve_slot(path: Path) -> SlotResult | Result:
    """The result of kind ``slot`` from a run's folder or its ``slot.json``."""
    data, folder = read_data_set(path)
    config = data.config()
    if data.look is None:
        why = data.outcome.reasons or ["not-measured: the run was finished before the slot was looked at"]
        return Result(kind="slot", verdict="fail", reasons=why, result=None)
    began = time.perf_counter()
    found = measure(data, data.look, folder)
    seconds = time.perf_counter() - began
    return _result(data, config, data.outcome, found, seconds, str(folder / path.name))


def _result(
    data: SlotData,
    config: SlotInsertionConfig,
    outcome: InsertionOutcome,
    found: MeasuredSlot,
    seconds: float,
    path: str,
) -> SlotResult:
    rack = config.rack.model()
    row, column = rack.row_and_column(config.slot)
    nominal = from_pose6(config.rack.T_base_rack) * rack.T_rack_slot(config.slot)
    xi = [float(v) for v in log_xi(nominal.inv() * found.T_base_slot)]
    by_marker = found.found.by_marker
    by = "its edges" if by_marker is None else "the edges of its marker"
    last, taken = outcome.states[-1], present(data.look, "look")
    warnings = [] if outcome.confirmed in (None, True) else [_UNCONFIRMED]
    good: Verdict = "warn" if warnings else "pass"
    return SlotResult(
        verdict=good if last is _wanted(config) and not outcome.reasons else "fail",
        warnings=warnings,
        reasons=list(outcome.reasons),
        result=SlotAnswer(
            action=config.action,
            slot=config.slot,
            row=row,
            column=column,
            part=last.value,
            states=[state.value for state in outcome.states],
            T_base_slot=[float(v) for v in to_pose6(found.T_base_slot)],
            correction=Correction(t=xi[:3], r=xi[3:]),
            budget=found.budget,
            travel_m=outcome.travel_m,
            force_n=outcome.force_n,
        ),
        uncertainty=SlotUncertainty(
            meaning=f"of the slot in the camera by {by} and what was known before; not of the insertion, "
            "which the budget is of",
            cov=(found.found.cov + (0.0 if by_marker is None else by_marker)).tolist(),
        ),
        residuals=SlotResiduals(
            meaning=f"how well {by} fit the known size; that is no accuracy",
            edge_px=found.found.edge_px,
            contrast=list(found.found.contrast),
            moved_px=found.found.moved_px,
        ),
        observability=SlotObservability(
            undetermined=[
                "the direction of the slot: it is the rack's, as configured, and in the budget by sigma_rad"
            ]
        ),
        inputs=SlotInputs(
            solve_seconds=seconds,
            path=path,
            pictures=len(taken.colour),
            arm_rms_m=data.arm_rms_m,
            arm_expected_m=found.arm.rms_m,
        ),
    )


def measured_in_run(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Of the worker: ``T_base_slot`` (6,) and, where a part is to go in, the ``budget``."""
    known = SlotData.model_validate(data)
    found = measure(known, present(known.look, "look"), folder)
    return {
        "T_base_slot": [float(v) for v in to_pose6(found.T_base_slot)],
        "edge_px": found.found.edge_px,
        "budget": None if found.budget is None else found.budget.model_dump(),
    }
