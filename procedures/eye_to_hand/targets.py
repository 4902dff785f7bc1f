"""The ways to targets that a fixed camera wants, for the worker process: plain values in, moves out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.planning import ConeRequest, Volume, beyond_volume
from calibration.planning.planner import Checker, judged_once
from calibration.planning.view import view_faults
from calibration.targets import make_target
from cell.arm_model import ArmModel
from cell.devices import Intrinsics
from cell.errors import RefusedError, error
from cell.formats.axbc import How
from cell.poses import Array, from_pose6, to_pose6
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings
from procedures.hand_eye.plan import BoardObservation, camera_to_target


@dataclass(frozen=True)
class TargetMove:
    """One target in one way: the ``T_base_flange`` commanded, and joints ``q`` (rad) on a way that was
    checked; empty where ``why`` says what keeps the arm from it."""

    target: int
    how: How
    command: list[float]
    q: list[float] = field(default_factory=list)
    why: str = ""
    checks: Mapping[str, Any] = field(default_factory=dict)  # margins there


class Refusals:
    """What kept the arm from targets, at each place where it was tried."""

    def __init__(self) -> None:
        self._by: dict[tuple[int, How], list[str]] = {}

    def __contains__(self, move: TargetMove) -> bool:
        return (move.target, move.how) in self._by

    def __len__(self) -> int:
        return len(self._by)

    def add(self, move: TargetMove, why: str) -> None:
        self._by.setdefault((move.target, move.how), []).append(why)

    def why(self, move: TargetMove) -> str:
        """As it was refused first, and from how many more places it was tried."""
        first, *more = self._by[move.target, move.how]
        if not more:
            return first
        places = f"{len(more)} other place{'s' if len(more) > 1 else ''}"
        return f"{first}; tried from {places} as well"


@dataclass(frozen=True)
class TargetView:
    """What the camera sees of the target on the flange: its table, its place there, and the lens as told."""

    table: Mapping[str, Any]
    T_marker_flange: Sequence[float]
    lens: Mapping[str, Any]

    def fault(self, T_camera_flange: Sequence[float]) -> str | None:
        """Why the target cannot be measured with the flange there."""
        told = self.lens
        lens = Intrinsics(told["width"], told["height"], tuple(told["K"]), tuple(told["dist"]))
        seen = self.seen(T_camera_flange)
        (fault,) = view_faults(seen, make_target(self.table).points, lens, ConeRequest.margin_px)
        return fault

    def seen(self, T_camera_flange: Sequence[float]) -> RigidTransform:
        """T_camera_target with the flange there."""
        return from_pose6(T_camera_flange) * from_pose6(self.T_marker_flange).inv()


@dataclass(frozen=True)
class TargetsAsGiven:
    """What is known of targets before anything moves.

    ``given`` is T_base_camera (6,), ``known`` (n, 6) are the poses that come before, and ``start`` (6,) is
    where the arm begins and returns to. ``volume`` is what the poses are spread over.
    """

    given: Sequence[float]
    targets: Sequence[Sequence[float]]
    known: Sequence[Sequence[float]]
    start: Sequence[float]
    volume: Volume


def list_targets(values: RunValues, view: TargetView, of: TargetsAsGiven) -> list[dict[str, Any]]:
    """Each target as given, in the order of the visits and then those that are left out: joints on a way that
    was checked, or ``why`` it has none; and where one that is driven to lies ``outside`` of the volume.
    Commands as corrected are found from the poses alone."""
    near = near_joints(values, of.given, of.targets, of.known or [of.start])
    given = [to_pose6(T).tolist() for T in commands_as_given(of.given, of.targets)]
    commands: list[tuple[int, How, list[float]]] = [(k, "given", T) for k, T in enumerate(given)]
    guard, _, _ = lease_settings(values)
    begun = from_pose6(of.given).inv() * guard.model.forward(np.array(of.start))
    seen, points = view.seen(to_pose6(begun).tolist()), make_target(view.table).points
    rows = []
    for move in plan_moves(values, view, of.targets, commands, near, of.start, of.start):
        target = of.targets[move.target]
        outside = None if move.why else beyond_volume(of.volume, view.seen(target), seen, points)
        rows.append(
            {
                "number": move.target + 1,
                "T_camera_flange": list(target),
                "given": move.command,
                "q": move.q,
                "checks": dict(move.checks),
                "why": move.why,
                "outside": outside or "",
            }
        )
    return rows


def commands_as_given(given: Sequence[float], targets: Sequence[Sequence[float]]) -> list[RigidTransform]:
    """``T_base_flange`` of each target, T_camera_flange, through ``given``, T_base_camera."""
    return [from_pose6(given) * from_pose6(target) for target in targets]


def off_in_view(
    view: BoardObservation,
    table: Mapping[str, Any],
    T_marker_flange: Sequence[float],
    T_camera_flange: Sequence[float],
) -> float:
    """How far the target is from where it was wanted, by one frame (m)."""
    wanted = from_pose6(T_camera_flange) * from_pose6(T_marker_flange).inv()
    seen = camera_to_target(view, make_target(table).points)
    return float(np.linalg.norm(seen.translation - wanted.translation))


def near_joints(
    values: RunValues,
    given: Sequence[float],
    targets: Sequence[Sequence[float]],
    known: Sequence[Sequence[float]],
) -> list[list[float]]:
    """Joints that pick the branch at each target: its own as given where the arm reaches it, near those of
    the closest of the poses ``known`` (n, 6), which were visited."""
    guard, _, _ = lease_settings(values)
    Q = np.array(known, dtype=float)
    at = np.array([guard.model.forward(q).translation for q in Q])
    return [
        _near(guard.model, command, Q[int(np.argmin(np.linalg.norm(at - command.translation, axis=1)))])
        for command in commands_as_given(given, targets)
    ]


def _near(model: ArmModel, command: RigidTransform, closest: Array) -> list[float]:
    q = model.inverse(command, closest)
    return [float(v) for v in (closest if q is None else q)]


def plan_moves(
    values: RunValues,
    view: TargetView,
    targets: Sequence[Sequence[float]],
    commands: Sequence[tuple[int, How, list[float]]],
    near: Sequence[Sequence[float]],
    q_now: Sequence[float],
    home: Sequence[float],
) -> list[TargetMove]:
    """``commands`` (target, how, T_base_flange) in the order of the visits, then those that are left out;
    each way is checked as the lease checks it, and so is the way from there back ``home``.

    One that has no way from where the arm stands waits: it is tried again from each place that the arm comes
    to, before the next one, until none of those that wait has a way.
    """
    guard, _, _ = lease_settings(values)
    check, end = judged_once(guard.check_path_joints), np.array(home, dtype=float)
    never, waiting = list[TargetMove](), list[tuple[TargetMove, Array]]()
    for k, how, command in commands:
        why = view.fault(targets[k])
        q = None if why else guard.model.inverse(from_pose6(command), np.array(near[k]))
        if q is None:
            never.append(TargetMove(k, how, command, why=why or "out of the arm's reach"))
        else:
            waiting.append((TargetMove(k, how, command, [float(v) for v in q]), q))
    stood, out = [np.array(q_now, dtype=float)], list[TargetMove]()
    refused = Refusals()
    while waiting:
        for row, (move, q) in enumerate(waiting):
            if (why := _why_not(check, stood, q, end)) is None:
                out.append(replace(move, checks=guard.describe(q).as_dict()))
                stood.append(q)
                del waiting[row]
                break
            refused.add(move, why)
        else:
            break
    never += [replace(move, q=[], why=refused.why(move)) for move, _ in waiting]
    return out + sorted(never, key=lambda move: commands.index((move.target, move.how, move.command)))


def _why_not(check: Checker, stood: Sequence[Array], q: Array, home: Array) -> str | None:
    """What keeps the arm from ``q``, or from there ``home``; it is on the last place where it ``stood``."""
    try:
        check(stood[-1], q)
    except RefusedError as refusal:
        return str(refusal)
    try:
        _steps_back(check, [*stood, q], home)
    except RefusedError as refusal:
        return f"no way back from there: {refusal}"
    return None


def no_return(
    values: RunValues, stood: Sequence[Sequence[float]], q: Sequence[float], home: Sequence[float]
) -> str | None:
    """Why there would be no way back ``home`` from ``q`` with the arm after the places where it ``stood``."""
    try:
        way_back(values, [*stood, q], home)
    except RefusedError as refusal:
        return f"no way back from there: {refusal}"
    return None


def way_back(values: RunValues, stood: Sequence[Sequence[float]], home: Sequence[float]) -> int:
    """By how many of the poses ``stood`` (n, 6) rad, on the last of which the arm is, it goes back before it
    can go straight ``home``; each way is checked. A ``RefusedError`` says why it cannot get there."""
    guard, _, _ = lease_settings(values)
    places, end = [np.array(q, dtype=float) for q in stood], np.array(home, dtype=float)
    return _steps_back(guard.check_path_joints, places, end)


def _steps_back(check: Checker, stood: Sequence[Array], home: Array) -> int:
    first: RefusedError | None = None
    for steps, at in enumerate(reversed(stood)):
        if steps:
            check(stood[-steps], at)
        try:
            check(at, home)
        except RefusedError as refusal:
            first = first or refusal
            continue
        return steps
    raise first or error("INTERNAL", "the arm stood nowhere")
