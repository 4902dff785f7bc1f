"""An insertion on a twin, behind the capture of the hand-eye, with a rack near its nominal place."""

import numpy as np

from cell.known_cell import KnownMarker, KnownRack
from cell.poses import from_pose6, to_pose6
from procedures.rehearsal import Rehearsal, cannot, gripper, joints, needed
from procedures.setup import Setup
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.marking import marker_problem
from procedures.words import mm

CAPTURE = "cone-capture"
_WITHIN_M = 0.002  # of the tool's point beside the line through the part that a twin's fingers close on


def rehearse_slot(setup: Setup, job: SlotInsertionConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    needed(setup, "arm", "flange_camera", "gripper")
    look, _ = joints(setup, job.start_pose)
    for name in (job.fetch_pose, job.put_down_pose):
        joints(setup, name)
    if why := marker_problem(job):
        raise cannot(why)
    part = from_pose6(job.part.T_tool_part)
    aside_x, aside_y, ahead = -part.inv().translation
    aside = float(np.hypot(aside_x, aside_y))
    if not (aside <= _WITHIN_M and 0.0 < ahead <= job.part.length_m):
        raise cannot(
            "the fingers of a twin close on the middle line of a part, and by part.T_tool_part the tool's "
            f"point is {mm(aside)} beside it and {mm(ahead)} behind the front of a part of "
            f"{mm(job.part.length_m)}"
        )
    inserts = job.action != "pull"
    fetched = inserts and job.fetch_pose is not None
    rack = KnownRack(
        T_base_rack=job.rack.T_base_rack,
        rows=job.rack.rows,
        columns=job.rack.columns,
        row_pitch_m=job.rack.row_pitch_m,
        column_pitch_m=job.rack.column_pitch_m,
        opening_m=(job.opening.width_m, job.opening.height_m),
        chamfer_m=job.opening.chamfer_m,
        depth_m=job.opening.depth_m,
        part_m=(job.part.width_m, job.part.height_m, job.part.length_m),
        T_flange_part=to_pose6(from_pose6(setup.values.tool["T_flange_tool"]) * part).tolist(),
        grasp_m=float(ahead),
        sigma_m=job.rack.sigma_m,
        sigma_rad=job.rack.sigma_rad,
        part_sigma_m=job.part.sigma_m,
        part_sigma_rad=job.part.sigma_rad,
        filled=job.slot if job.action != "insert" else None,
        q_fetch=joints(setup, job.fetch_pose)[1] if fetched else None,
        handed=inserts and not fetched,
        marker=_marker(job),
    )
    return Rehearsal(look, gripper=gripper(setup), rack=rack, before=(CAPTURE,))


def _marker(job: SlotInsertionConfig) -> KnownMarker | None:
    marker = job.marker
    if marker is None:
        return None
    return KnownMarker(
        marker.dictionary, marker.id, marker.size_m, marker.T_slot_marker, marker.sigma_m, marker.sigma_rad
    )
