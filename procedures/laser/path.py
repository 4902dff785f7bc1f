"""Where the flange goes: from the stored geometry and the tool in use to poses beside, across and below."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.arm_model import ArmModel
from cell.errors import error
from cell.poses import Array, from_pose6
from procedures.laser.config import BEAMS, Search

SAME_ATTITUDE_RAD = 0.02  # between the two auxiliary points, as a person teaches them
UP = np.array([0.0, 0.0, 1.0])
FIXTURE_M = 0.1  # around a sweep: sensors and their holders are there


@dataclass(frozen=True, eq=False)
class BeamStation:
    """One beam at one place along it. ``q`` (6,) are the joints of the auxiliary point, also for place 1.

    Positions are counted from the auxiliary point: ``s`` m along ``across``, ``depth`` m down.
    """

    beam: str
    place: int
    q: Array
    start: RigidTransform  # T_base_flange at the place's start, s = 0 and depth = 0
    across: Array
    distance_m: float
    taught: bool  # the auxiliary joints are the start

    def at(self, s: float, depth: float) -> RigidTransform:
        """``T_base_flange`` at ``s`` and ``depth``."""
        flange = self.start.as_matrix()
        flange[:3, 3] += s * self.across - depth * UP
        return RigidTransform(flange, normalize=False, copy=False)

    def s_of(self, along: Array) -> Array:
        """(k,) m from the auxiliary point, for (k,) positions of the flange along ``across`` in the base."""
        found: Array = along - self.start.translation @ self.across
        return found

    @property
    def name(self) -> str:
        return f"beam {self.beam}, place {self.place + 1}"


@dataclass(frozen=True, eq=False)
class Course:
    """All stations of one scan, and the tool's point in the flange that they were made for."""

    stations: tuple[BeamStation, ...]
    tool_point: Array  # (3,) in the flange
    R_base_flange: Rotation

    def tip(self, T_base_flange: RigidTransform) -> Array:
        """(3,) the tool's point in the base, as believed."""
        found: Array = T_base_flange.apply(self.tool_point)
        return found


def course(
    search: Search,
    model: ArmModel,
    T_flange_tool: Sequence[float],
    p_ref: Sequence[float] | None,
    places: int,
) -> Course:
    """The stations of a scan with the tool ``T_flange_tool`` (a pose6).

    The attitude is that of beam xs; at the other auxiliary point the tool's point stays where it was taught.
    With ``p_ref`` (3,), the tool's point of the reference in the flange, all flange poses are shifted so that
    the point of this tool follows the path that the reference's did.
    """
    tool = from_pose6(T_flange_tool).translation
    taught = tool if p_ref is None else np.array(p_ref, dtype=float)
    aux = {name: model.forward(np.array(search.beam(name).q)) for name in BEAMS}
    R = aux["xs"].rotation
    apart = float((R.inv() * aux["ys"].rotation).magnitude())
    if apart > SAME_ATTITUDE_RAD:
        raise error(
            "ARGUMENT_INVALID",
            f"the poses '{search.xs.aux}' and '{search.ys.aux}' differ by {np.degrees(apart):.1f} deg in "
            f"attitude, more than {np.degrees(SAME_ATTITUDE_RAD):.1f} deg; teach both in the same attitude",
        )
    stations = []
    for name in BEAMS:
        beam = search.beam(name)
        start = aux[name].apply(taught) - R.apply(tool)
        for place in range(places):
            T = RigidTransform.from_components(start + place * beam.along_m * beam.along_unit, R)
            taught_here = bool(np.allclose(T.as_matrix(), aux[name].as_matrix(), rtol=0.0, atol=1e-6))
            q, across = np.array(beam.q), beam.across_unit
            stations.append(BeamStation(name, place, q, T, across, beam.distance_m, taught_here))
    return Course(tuple(stations), tool, R)


def way_out(course: Course, flange: RigidTransform) -> RigidTransform | None:
    """Where to lift the flange before anything else, straight up; None when the tool stands in no beam's way.

    A run that was stopped leaves the tool between the sensors, and the way from there is up, not sideways.
    """
    tip = course.tip(flange)
    top = max(float(course.tip(station.start)[2]) for station in course.stations)
    if tip[2] > top - 1e-6:
        return None
    for station in course.stations:
        middle = course.tip(station.at(0.5 * station.distance_m, 0.0))
        if float(np.linalg.norm((tip - middle)[:2])) < station.distance_m + FIXTURE_M:
            lifted = flange.translation + (top - tip[2]) * UP
            return RigidTransform.from_components(lifted, flange.rotation)
    return None


def heights_at(search: Search, station: BeamStation) -> tuple[float, ...]:
    """How far below the beam's height a station is measured, m; one is enough to find where the beam runs."""
    return search.heights if station.place == 0 else search.heights[:1]


def highest(search: Search) -> float:
    """How far above the auxiliary point the search may go when the beam is met at once, m."""
    return search.tool_margin_m


def deepest(search: Search, course: Course, station: BeamStation) -> float:
    """How far down the search may go from the auxiliary point, m.

    Below what it finds there must be room to measure, at both heights, above the floor.
    """
    room = float(course.tip(station.start)[2]) - search.floor_m
    return min(search.max_descents * search.descend_step_m, room - search.heights[-1])
