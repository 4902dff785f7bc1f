"""A rack that is not quite where it was drawn, and parts as a gripper takes them."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.known_cell import KnownMarker, KnownRack
from cell.poses import from_pose6, to_pose6
from fakes.world.arm.true_arm import TrueArm
from fakes.world.arm.truth import ArmTruth


def draw_rack(known: KnownRack, arm: ArmTruth, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    """``rack`` of a scenario's world, whose ``seed`` drew the gears of ``arm``.

    A part that is fetched lies where the arm, as it truly stands there, takes it as well as is stated.
    """
    T_flange_part = from_pose6(known.T_flange_part)
    rack: dict[str, Any] = {
        "T_base_rack": _drawn(from_pose6(known.T_base_rack), known.sigma_m, known.sigma_rad, rng),
        "rows": known.rows,
        "columns": known.columns,
        "row_pitch_m": known.row_pitch_m,
        "column_pitch_m": known.column_pitch_m,
        "opening_m": list(known.opening_m),
        "chamfer_m": known.chamfer_m,
        "depth_m": known.depth_m,
        "part_m": list(known.part_m),
        "grasp_m": known.grasp_m,
        "parts": [] if known.filled is None else [{"slot": known.filled}],
    }
    gripped = from_pose6(_drawn(T_flange_part, known.part_sigma_m, known.part_sigma_rad, rng))
    if known.handed:
        rack["handed"] = to_pose6(gripped).tolist()
    elif known.q_fetch is not None:
        flange = TrueArm.of(arm, seed).forward(np.array(known.q_fetch))
        rack["parts"].append({"T_base_part": to_pose6(flange * gripped).tolist()})
    if known.marker is not None:
        rack["marker"] = _marker(known.marker, rng)
    return rack


def _marker(known: KnownMarker, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "dictionary": known.dictionary,
        "id": known.id,
        "size_m": known.size_m,
        "T_slot_marker": _drawn(from_pose6(known.T_slot_marker), known.sigma_m, known.sigma_rad, rng),
    }


def _drawn(T: RigidTransform, sigma_m: float, sigma_rad: float, rng: np.random.Generator) -> list[float]:
    """(6,): ``T``, off along and about each of its own axes."""
    turn = Rotation.from_rotvec(sigma_rad * rng.standard_normal(3))
    off = RigidTransform.from_components(sigma_m * rng.standard_normal(3), turn)
    pose: list[float] = to_pose6(T * off).tolist()
    return pose
