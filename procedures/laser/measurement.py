"""What the crossed-beam jobs share: from a geometry to a checked plan, a scan, and a data set."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.tool_frame.repeatability import stated_sigma
from cell.calibrations import laser_reference
from cell.errors import error
from cell.poses import from_pose6
from cell.procedure import Run
from cell.run_values import RunValues
from procedures.arm_setup import arm_model, lease_settings
from procedures.kinematics_in_use import require_same_model
from procedures.laser.config import BEAMS, Search
from procedures.laser.path import course
from procedures.laser.plan import PlanRequest, note_plan, plan_scan
from procedures.laser.record import PassRecord
from procedures.laser.scan import Scan

SPEEDS = ("search_speed_m_s", "measure_speed_m_s")


@dataclass(frozen=True)
class Measurement:
    """One fixture and one reference, for as many scans as a job makes.

    ``p_ref`` (3,) is the tool's point of the reference in the flange; None while a reference is made.
    ``offset_s`` is the delay of the inputs that the stamps are corrected by: that of the reference, not
    today's, for the passes of both must be late alike.
    """

    run: Run
    search: Search
    places: int
    p_ref: list[float] | None
    offset_s: float
    retract_pose: str | None
    max_U_m: float

    def check_fixture(self) -> None:
        """``LASER_OTHER_FIXTURE`` when the geometry was made with other inputs than there are."""
        if self.run.adopted is not None:
            raise error(
                "NOT_NOW", "a crossed-beam run cannot be adopted: its passes belong together; start anew"
            )
        inputs = self.run.inputs("beams")
        if inputs.name != self.search.device:
            raise error(
                "LASER_OTHER_FIXTURE", f"it used the inputs '{self.search.device}', not '{inputs.name}'"
            )
        for beam in BEAMS:
            if (name := self.search.beam(beam).input) not in inputs.names:
                known = ", ".join(inputs.names)
                raise error("LASER_OTHER_FIXTURE", f"{inputs.name} has no input '{name}', there is {known}")

    async def plan(self, tool: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Every move with the guard's findings, with ``tool`` instead of the run's; nothing moves."""
        return await self.run.worker.call(plan_scan, await self.request(tool))

    async def request(self, tool: Mapping[str, Any] | None = None) -> PlanRequest:
        """What a plan is made from: this geometry, and where the arm stands now."""
        without_passes = replace(self.run.values, laser_reference=None, tool=tool or self.run.values.tool)
        q = (await self.run.arm_state()).q
        return PlanRequest(
            without_passes, self.search.model_dump(), self.p_ref, self.places, q.tolist(), self.retract_pose
        )

    def scan(self, record: PassRecord, tool: Mapping[str, Any] | None = None, scans: int = 1) -> Scan:
        """A scan that is ready to be taken, the first of ``scans`` that the run makes when all goes well."""
        values = self.run.values
        pose = (tool or values.tool)["T_flange_tool"]
        way = course(self.search, arm_model(values), pose, self.p_ref, self.places)
        _, _, speed = lease_settings(values)
        late = self.offset_s - float(values.time_offset_s["beams"]["applied"])
        sigma_m = stated_sigma(values.robot.get("model"))
        return Scan(
            self.run,
            self.search,
            way,
            record,
            speed,
            late,
            self.retract_pose,
            sigma_m,
            scans,
            self.max_U_m,
        )

    async def plan_and_note(self, tool: Mapping[str, Any] | None = None) -> None:
        """The plan in the journal before anything moves; ``LASER_PLAN_REFUSED`` when the guard forbids it."""
        note_plan(self.run, await self.plan(tool))


def check_speeds(search: Mapping[str, Any], values: RunValues) -> None:
    """``MOTION_LIMIT`` when a sweep would be faster than the cell allows."""
    allowed = values.limits["speed_m_s"]
    for key in SPEEDS:
        if search[key] > allowed:
            raise error("MOTION_LIMIT", f"{key} is {search[key]:g} m/s, [limits] speed_m_s {allowed:g} m/s")


def check_poses(names: Mapping[str, str | None], values: RunValues) -> None:
    """``ARGUMENT_INVALID`` when a key names a pose that is not in ``[poses]``."""
    for key, name in names.items():
        if name is not None and name not in values.poses:
            known = ", ".join(values.poses) or "none"
            raise error("ARGUMENT_INVALID", f"{key} '{name}' is not in [poses]; there is {known}")


def known_reference(values: RunValues) -> Mapping[str, Any]:
    """The reference in effect; ``LASER_NO_REFERENCE`` without one."""
    if values.laser_reference is None:
        raise error("LASER_NO_REFERENCE", f"tool '{values.tool['name']}'")
    return values.laser_reference


def reference_of(values: RunValues) -> Mapping[str, Any]:
    """The reference of this tool; ``LASER_NO_REFERENCE``, or ``LASER_OTHER_FIXTURE`` when it does not fit.

    ``KINEMATICS_DIFFER`` when its places were told by another model of the arm than is in use now. A pose
    that was taught anew means that fixture, tool or cell was moved.
    """
    tool = values.tool["name"]
    reference = known_reference(values)
    if reference["tool"]["id"] != tool:
        raise error("LASER_NO_REFERENCE", f"it is of tool '{reference['tool']['id']}', not '{tool}'")
    require_same_model(values, laser_reference(tool))
    search = Search.from_reference(reference, None)
    for name in BEAMS:
        beam = search.beam(name)
        now = values.poses.get(beam.aux)
        if now is None:
            raise error("LASER_OTHER_FIXTURE", f"[poses] has no '{beam.aux}' any more")
        if float(np.max(np.abs(np.array(now) - np.array(beam.q)))) > 1e-6:
            raise error("LASER_OTHER_FIXTURE", f"the pose '{beam.aux}' was taught anew since")
    return reference


def data_header(measurement: Measurement, reference: Mapping[str, Any]) -> dict[str, Any]:
    """Attitude, beams and tool of a ``cellward.laser/1`` data set that is held against ``reference``."""
    return {
        "R_base_flange": list(reference["R_base_flange"]),
        "beams": reference["beams"],
        "tool": reference["tool"],
        "repeatability_m": stated_sigma(measurement.run.values.robot.get("model")),
    }


def nominal_header(
    measurement: Measurement, tool: Mapping[str, Any], radius_m: float | None
) -> dict[str, Any]:
    """The same while there is no reference: beams and tool as configured."""
    way = course(measurement.search, arm_model(measurement.run.values), tool["T_flange_tool"], None, 1)
    T = from_pose6(tool["T_flange_tool"])
    beams = {}
    for station in way.stations:
        beam = measurement.search.beam(station.beam)
        middle = way.tip(station.at(0.5 * station.distance_m, 0.0))
        beams[station.beam] = {"point": middle.tolist(), "dir": beam.along_unit.tolist()}
    return {
        "R_base_flange": way.R_base_flange.as_rotvec().tolist(),
        "beams": beams,
        "tool": {
            "id": tool["name"],
            "p_ref": T.translation.tolist(),
            "axis_ref": T.rotation.apply([0.0, 0.0, 1.0]).tolist(),
            "radius": radius_m if radius_m is not None else tool["radius_m"],
        },
        "repeatability_m": stated_sigma(measurement.run.values.robot.get("model")),
    }
