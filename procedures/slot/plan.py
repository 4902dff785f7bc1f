"""Planning for the worker process: joints for each station, and every way checked; nothing here moves."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.errors import error
from cell.poses import Array, from_pose6, to_pose6
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.stations import Stations, along


@dataclass(frozen=True)
class Route:
    """Joints (6,) rad of what the job visits; ``listing`` is what a person wants to see."""

    look: list[float]
    before: list[float]
    seated: list[float]
    listing: dict[str, Any]


def plan_route(
    values: RunValues, job: Mapping[str, Any], T_base_slot: list[float] | None, q_now: list[float]
) -> Route:
    """Of the slot where it is, or where the rack's model has it.

    ``MOTION_UNREACHABLE``, ``MOTION_LIMIT`` or ``MOTION_COLLISION`` names the station.
    """
    config = SlotInsertionConfig.model_validate(job)
    stations, (guard, _, _) = Stations.of(config, values), lease_settings(values)
    T_slot = stations.nominal_slot() if T_base_slot is None else from_pose6(T_base_slot)
    near = np.array(values.poses[config.start_pose])
    insertion, depth = config.insertion, config.opening.depth_m
    flange = {
        "look": stations.look(T_slot),
        "before": stations.front_at(T_slot, -insertion.clear_m),
        "seated": stations.front_at(T_slot, depth),
    }
    joints = {name: _joints(guard.model.inverse(T, near), name, T) for name, T in flange.items()}
    guard.check_path_joints(np.array(q_now), joints["look"])
    guard.check_path_joints(joints["look"], joints["before"])
    reach = stations.front_at(T_slot, depth + insertion.tolerance_m)
    guard.check_path_linear(flange["before"], reach, joints["before"], insertion.speed_m_s)
    for key in ("fetch_pose", "put_down_pose"):
        name = getattr(config, key)
        if name is not None:
            q = np.array(values.poses[name])
            joints[key.removesuffix("_pose")] = q
            above = above_place(config, guard.model.forward(q))
            guard.check_path_joints(near, _joints(guard.model.inverse(above, q), f"above {name}", above))
            guard.check_path_linear(guard.model.forward(q), above, q)
    poses = [
        {
            "index": k,
            "pose": name,
            "q": [float(v) for v in q],
            "T_base_flange": [float(v) for v in to_pose6(guard.model.forward(q))],
            "checks": guard.describe(q).as_dict(),
        }
        for k, (name, q) in enumerate(joints.items())
    ]
    row, column = config.rack.model().row_and_column(config.slot)
    listing = {
        "kind": "slot",
        "action": config.action,
        "slot": config.slot,
        "row": row,
        "column": column,
        "travel_m": depth,
        "max_force_n": insertion.max_force_n,
        "poses": poses,
    }
    of = {name: [float(v) for v in q] for name, q in joints.items()}
    return Route(of["look"], of["before"], of["seated"], listing)


def above_place(config: SlotInsertionConfig, T_base_flange: RigidTransform) -> RigidTransform:
    """Before a place where a part is gripped or let go, back along the tool."""
    part = config.part
    out = from_pose6(part.T_tool_part).translation[2]
    return T_base_flange * along(-max(config.insertion.clear_m, part.length_m - float(out)))


def _joints(q: Array | None, name: str, T: RigidTransform) -> Array:
    if q is None:
        x, y, z = T.translation
        raise error("MOTION_UNREACHABLE", f"'{name}' puts the flange at {x:.3f}, {y:.3f}, {z:.3f} m")
    return q
