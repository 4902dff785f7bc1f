"""Planning for the worker process: which joints are sent, in which order; nothing here touches a device."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.identification.application import chain_of, reach
from calibration.iso9283 import five_places, other_corners
from calibration.kinematics.chain import SerialChain
from cell.errors import CellError, error
from cell.guard import PLANNED_CLEAR_M, MotionGuard
from cell.poses import Array, from_pose6, to_pose6
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings
from procedures.iso9283.config import Iso9283Config
from procedures.kinematics_in_use import LOAD_OF_A_RUN, other_arm, other_device, other_load

ORDER = ("P5", "P4", "P3", "P2", "P1")  # one cycle: every pose is always reached from the same one


@dataclass(frozen=True)
class TestPose:
    """A pose that is visited: the flange as wanted (pose6), the joints that are sent, and how far these are
    from what the controller's own model would send (m, at the flange)."""

    name: str
    T_base_flange: list[float]
    q: list[float]
    shift_m: float


@dataclass(frozen=True)
class IsoPlan:
    """``stations`` by name, those that only locate first; ``listing`` is what a person wants to see."""

    stations: list[TestPose]
    listing: dict[str, Any]


def kinematics_of(values: RunValues, config: Iso9283Config) -> Mapping[str, Any] | None:
    """The calibrated arm in effect if the config wants it; ``ISO9283_NO_KINEMATICS`` when there is none.

    So when it is of an arm with another drawing or factory calibration; ``PAYLOAD_DIFFERS`` when it was
    measured with another load than the arm has now.
    """
    corrected = is_corrected(values, config)
    if not (corrected or config.registration == "kinematics"):
        return None
    found: Mapping[str, Any] | None = values.kinematics.get("arm")
    if found is None:
        wanted = "corrected = true" if corrected else "registration = 'kinematics'"
        raise error("ISO9283_NO_KINEMATICS", f"{wanted}, and no kinematics of the arm is in effect")
    if why := other_load(found, float(values.payload_kg), LOAD_OF_A_RUN):
        raise error("PAYLOAD_DIFFERS", why)
    if why := other_arm(found, values.robot):
        raise error("ISO9283_NO_KINEMATICS", why)
    return found


def is_corrected(values: RunValues, config: Iso9283Config) -> bool:
    """Whether the poses are commanded through the calibrated arm: as all moves are, unless the job says."""
    return bool(values.use_kinematics) if config.corrected is None else config.corrected


def require_same_devices(
    found: Mapping[str, Any] | None, config: Iso9283Config, serials: Mapping[str, str]
) -> None:
    """``ISO9283_NO_KINEMATICS`` when the kinematics ``found`` in effect are of an arm with another serial.

    So for another tracker where its place is taken from them. An unknown serial says nothing.
    """
    roles = ("arm", "tracker") if config.registration == "kinematics" else ("arm",)
    for role in roles:
        if why := other_device(found or {}, role, serials.get(role)):
            raise error("ISO9283_NO_KINEMATICS", why)


def point_of(values: RunValues, config: Iso9283Config) -> list[float]:
    """The reflector in the flange: as calibrated where the tracker's place is taken from the calibration."""
    found = kinematics_of(values, config)
    if config.registration == "fit" or found is None:
        return list(config.point)
    places = (found["robot"].get("tool") or {}) if found["robot"].get("family") != "palletizer4" else {}
    if config.reflector not in places:
        raise error(
            "ISO9283_NO_KINEMATICS",
            f"registration = 'kinematics', and the calibration does not know reflector {config.reflector}; "
            f"it knows {', '.join(places) or 'none'}",
        )
    return [float(v) for v in places[config.reflector]]


def plan_iso(values: RunValues, raw: Mapping[str, Any], q_start: list[float]) -> IsoPlan:
    """Every pose with its joints; ``ISO9283_PLAN_REFUSED`` names the pose that cannot be reached, and why."""
    config = Iso9283Config.model_validate(raw)
    guard = lease_settings(values)[0]
    controller = chain_of(values.robot)
    calibrated = kinematics_of(values, config)
    corrected = is_corrected(values, config)
    chain = controller if not corrected or calibrated is None else chain_of(calibrated["robot"])
    near = np.array(values.poses[config.near], dtype=float)
    stations: list[TestPose] = []
    for name, T in wanted_poses(config, point_of(values, config)).items():
        q = _joints(name, T, near, chain)
        try:
            guard.check_joints(q)
        except CellError as exc:
            raise error("ISO9283_PLAN_REFUSED", f"pose {name}: {exc.detail}") from exc
        told = controller.flange(q[None])[0][:3, 3]
        shift = float(np.linalg.norm(told - T.translation))
        stations.append(TestPose(name, to_pose6(T).tolist(), q.tolist(), shift))
    by_name = {station.name: station for station in stations}
    route = [s.name for s in stations if s.name not in ORDER] + [*ORDER, ORDER[0]]
    _check_ways(guard, np.array(q_start), [by_name[name] for name in route])
    listing = {
        "poses": [
            {
                "index": k,
                "pose": s.name,
                "q": s.q,
                "T_base_flange": s.T_base_flange,
                "shift_m": s.shift_m,
                "checks": guard.describe(np.array(s.q)).as_dict(),
            }
            for k, s in enumerate(stations)
        ],
        "order": list(ORDER),
        "cycles": config.cycles,
        "arrivals": config.cycles * len(ORDER) + len(stations) - len(ORDER),
        "corrected": corrected,
        "speed_share": config.speed_share,
    }
    return IsoPlan(stations, listing)


def wanted_poses(config: Iso9283Config, point: list[float]) -> dict[str, RigidTransform]:
    """``T_base_flange`` by name: poses that only locate (R1 ...), then P1 to P5."""
    if config.cube is None:  # then there are poses
        return {f"P{k}": from_pose6(pose) for k, pose in enumerate(config.poses or (), 1)}
    cube, R = config.cube, Rotation.from_rotvec(config.cube.R_base_flange)
    arm = R.apply(point)

    def poses(letter: str, places: Array) -> dict[str, RigidTransform]:
        return {f"{letter}{k}": RigidTransform.from_components(p - arm, R) for k, p in enumerate(places, 1)}

    box = np.array(cube.centre), cube.edge_m, cube.plane
    return {**poses("R", other_corners(*box)), **poses("P", five_places(*box))}


def _joints(name: str, T: RigidTransform, near: Array, chain: SerialChain) -> Array:
    found = reach(chain, T.as_matrix()[None], near[None], near[None], level=False)
    if not found.found[0]:
        where = ", ".join(f"{v:.3f}" for v in T.translation)
        raise error(
            "ISO9283_PLAN_REFUSED",
            f"pose {name} with the flange at {where} m is out of the arm's reach from 'near'; the best "
            f"attempt stays {1e3 * found.miss[0]:.1f} mm (or mrad) off",
        )
    q: Array = found.q[0]
    return q


def _check_ways(guard: MotionGuard, q_start: Array, route: list[TestPose]) -> None:
    """The joint paths from where the arm is, and between all poses as they follow each other."""
    joints = [("where the arm is", q_start), *((s.name, np.array(s.q)) for s in route)]
    for (a, q0), (b, q1) in pairwise(joints):
        try:
            guard.check_path_joints(q0, q1, PLANNED_CLEAR_M)
        except CellError as exc:
            raise error("ISO9283_PLAN_REFUSED", f"from {a} to {b}: {exc.detail}") from exc
