"""The plan of a scan, for the worker process: every move that may come, in order, held against the guard."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.errors import CellError, error
from cell.guard import MotionGuard, Tool
from cell.poses import Array
from cell.procedure import Run
from cell.run_values import RunValues
from procedures.arm_setup import arm_model, lease_settings
from procedures.laser.config import Search
from procedures.laser.path import BeamStation, Course, course, deepest, heights_at, highest, way_out

MOTION_ERRORS = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE")


@dataclass(frozen=True)
class PlanRequest:
    """A scan to plan; ``q`` (6,) rad is where the arm stands, ``p_ref`` the tool's point of the reference.

    ``retract`` names the pose that it ends at, None to stay above the last beam.
    """

    values: RunValues
    search: dict[str, Any]
    p_ref: list[float] | None
    places: int
    q: list[float]
    retract: str | None = None


def plan_scan(request: PlanRequest) -> dict[str, Any]:
    """Every move from where the arm stands to the retract pose, each with the guard's findings.

    The guard knows the tool as longer by ``tool_margin_m``. ``sweeps`` are the moves, in order; ``sweeps`` of
    a move says how often it is made at most, there and back, and ``problem`` what forbids it. After a problem
    the rest of that station is left out.
    """
    moves, search = _begun(request)
    for station in moves.way.stations:
        moves.approach(station)
        _station(moves, search, station)
        if not moves.possible:  # what comes after is told as if the tool stood beside the beam again
            moves.q = station.q
    if request.retract is not None:
        moves.joints("retract", np.array(request.values.poses[request.retract]))
    return moves.as_plan(request.values.tool, search)


def plan_crossings(request: PlanRequest, beam: str, depth: float, times: int) -> dict[str, Any]:
    """Every move of crossing ``beam`` at its first place ``times`` at ``depth`` m, as :func:`plan_scan`."""
    moves, search = _begun(request)
    station = next(s for s in moves.way.stations if (s.beam, s.place) == (beam, 0))
    moves.approach(station)
    moves.sweeps(station, depth, times)
    if moves.possible:
        moves.line(_named(station, "lift"), station.at(0.0, 0.0), beam=beam, place=0)
    return moves.as_plan(request.values.tool, search)


def note_plan(run: Run, plan: Mapping[str, Any]) -> None:
    """The plan in the journal before anything moves; ``LASER_PLAN_REFUSED`` when the guard forbids it."""
    run.note("decision", event="plan", plan=plan)
    check_plan(plan)


def check_plan(plan: Mapping[str, Any]) -> None:
    """``LASER_PLAN_REFUSED`` with the first problem when the plan has any."""
    problems = plan["problems"]
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise error("LASER_PLAN_REFUSED", f"{problems[0]}{more}")


def _begun(request: PlanRequest) -> tuple["Moves", Search]:
    """From where the arm stands, out of the fixture if need be."""
    values, search = request.values, Search.model_validate(request.search)
    way = course(search, arm_model(values), values.tool["T_flange_tool"], request.p_ref, request.places)
    moves = Moves(longer_tool(values, search.tool_margin_m), way, np.array(request.q))
    moves.leave_fixture()
    return moves, search


def longer_tool(values: RunValues, margin_m: float) -> MotionGuard:
    """The guard of a run's values, with a tool that is longer by ``margin_m`` than configured."""
    guard, tool = lease_settings(values)[0], Tool.from_mapping(values.tool)
    length = float(np.linalg.norm(tool.T_flange_tool.translation))
    stretch = 1.0 + margin_m / length if length > 0.0 else 1.0
    T = RigidTransform.from_components(tool.T_flange_tool.translation * stretch, tool.T_flange_tool.rotation)
    return MotionGuard(guard.model, guard.limits, Tool(T, tool.radius_m, tool.name, tool.attachments))


def _station(moves: "Moves", search: Search, station: BeamStation) -> None:
    """Down by steps, up by steps where the beam is met at once; bisection; measured below the lowest."""
    limit = deepest(search, moves.way, station)
    if moves.possible and limit < 0.0:
        low = 1e3 * (float(moves.way.tip(station.start)[2]) - search.floor_m)
        moves.refuse(
            station,
            f"no room to search: the point is {low:.1f} mm above the floor, and measuring needs "
            f"{1e3 * (search.measure_depth_m + search.tilt_height_m):.1f} mm",
        )
        return
    step = search.descend_step_m
    moves.sweeps(station, 0.0, 1)
    for k in range(1, int(np.floor(highest(search) / step + 1e-9)) + 1):
        moves.sweeps(station, -k * step, 1, ", if met at once")
    lowest = 0.0
    for k in range(1, int(np.floor(limit / step + 1e-9)) + 1):
        lowest = k * step
        moves.sweeps(station, lowest, 1)
    first, *deeper = heights_at(search, station)
    moves.sweeps(station, lowest + first, 1, " or higher, located")
    if search.most_height_pairs:
        moves.sweeps(station, lowest, search.most_height_pairs, " or higher, search in height")
    moves.sweeps(station, lowest + first, search.passes, " or higher, measured")
    for below in deeper:
        moves.sweeps(station, lowest + below, 1 + search.passes, " or higher, measured")
    moves.lift(station)


@dataclass
class Moves:
    """Moves in the order in which they are made, each checked from where the one before it ended."""

    guard: MotionGuard
    way: Course
    q: Array  # (6,) where the arm stands
    rows: list[dict[str, Any]] = field(default_factory=list)
    possible: bool = True  # so far, since the last approach

    def __post_init__(self) -> None:
        self.q_far = self.q  # at the far end of the last sweep

    def leave_fixture(self) -> None:
        """Straight up, when the tool stands between the sensors."""
        above = way_out(self.way, self.guard.model.forward(self.q))
        if above is not None:
            self.line("lift out of the fixture", above)

    def approach(self, station: BeamStation) -> None:
        """To the place's start: in joints to the auxiliary point, then straight where it is another."""
        self.possible = True
        if station.place == 0:
            self.joints(f"{station.beam} approach", station.q, beam=station.beam)
        if self.possible and not station.taught:
            self.line(_named(station, "start"), station.start, beam=station.beam, place=station.place)

    def joints(self, index: str, q: Array, **more: Any) -> None:
        """A move in joints to ``q`` (6,) rad."""
        problem = None
        try:
            self.guard.check_path_joints(self.q, q)
        except CellError as exc:
            problem = self._told(exc)
        before, self.q = self.q, q
        self._row(index, self._tightest(before, q), problem, **more)

    def line(self, index: str, to: RigidTransform, **more: Any) -> None:
        """A move of the tool on a line until the flange has this pose."""
        before, problem = self.q, None
        try:
            self.q = self._line_to(to)
        except CellError as exc:
            problem = self._told(exc)
        begin = self.way.tip(self.guard.model.forward(before))
        ends = {"from": begin.tolist(), "to": self.way.tip(to).tolist()}
        self._row(index, self._tightest(before, self.q), problem, **more, **ends)

    def sweeps(self, station: BeamStation, depth: float, times: int, when: str = "") -> None:
        """Down or up beside the beam to ``depth`` m, and ``times`` across it and back."""
        if not self.possible:
            return
        near, far = station.at(0.0, depth), station.at(station.distance_m, depth)
        worst, problem = self.q, None
        try:
            self.q = self._line_to(near)
            self.q_far = self._line_to(far)
            worst = self._tightest(self.q, self.q_far)
        except CellError as exc:
            problem = self._told(exc)
        more = {"beam": station.beam, "place": station.place, "depth_m": depth, "sweeps": times}
        ends = {"from": self.way.tip(near).tolist(), "to": self.way.tip(far).tolist()}
        self._row(_named(station, f"at {1e3 * depth:.1f} mm{when}"), worst, problem, **more, **ends)

    def lift(self, station: BeamStation) -> None:
        """Straight up from the far end of the last sweep, which is the farthest there is, and back."""
        if not self.possible:
            return
        about = {"beam": station.beam, "place": station.place}
        self.q = self.q_far
        self.line(_named(station, "lift"), station.at(station.distance_m, 0.0), **about)
        self.line(_named(station, "back"), station.start, **about)

    def refuse(self, station: BeamStation, problem: str) -> None:
        """A station that cannot be measured at all."""
        ends = {"from": self.way.tip(station.start).tolist(), "to": None}
        self._row(
            _named(station, "at 0.0 mm"), self.q, problem, beam=station.beam, place=station.place, **ends
        )

    def as_plan(self, tool: Mapping[str, Any], search: Search) -> dict[str, Any]:
        """What a dry run shows."""
        total = sum(row["sweeps"] for row in self.rows)
        length = float(np.linalg.norm(tool["T_flange_tool"][:3]))
        return {
            "sweeps": self.rows,
            "note": (
                f"{total} sweeps at most, each there and back; checked with a tool that is "
                f"{1e3 * search.tool_margin_m:g} mm longer than {tool['name']} as configured "
                f"({1e3 * length:.1f} mm)"
            ),
            "floor_m": search.floor_m,
            "problems": [f"{row['index']}: {row['problem']}" for row in self.rows if row["problem"]],
        }

    def _line_to(self, to: RigidTransform) -> Array:
        """Check the line from where the arm stands and give the joints (6,) at its end."""
        self.guard.check_path_linear(self.guard.model.forward(self.q), to, self.q)
        found = self.guard.model.inverse(to, self.q)
        if found is None:
            raise error("MOTION_UNREACHABLE", "the end of the line has no joints within range")
        return found

    def _tightest(self, *ends: Array) -> Array:
        """The joints (6,) that are nearest to a limit of the guard's."""

        def margin(q: Array) -> float:
            found = self.guard.describe(q)
            clearance = np.inf if found.clearance_m is None else found.clearance_m
            return min(clearance, found.workspace_m, found.floor_m, found.self_m)

        return min(ends, key=margin)

    def _row(self, index: str, q: Array, problem: str | None, **more: Any) -> None:
        self.possible = self.possible and problem is None
        row = {"index": index, "q": [float(v) for v in q], "problem": problem, "sweeps": 0, **more}
        self.rows.append({**row, "checks": self.guard.describe(q).as_dict()})

    def _told(self, exc: CellError) -> str:
        """A finding of the guard; anything else is not for a plan."""
        if exc.name not in MOTION_ERRORS:
            raise exc
        return str(exc)


def _named(station: BeamStation, what: str) -> str:
    return f"{station.beam} {station.place + 1} {what}"
