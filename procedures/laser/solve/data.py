"""A data set of passes across two beams in memory, and what in it looks like a mistake of units."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.tool_frame.scene import Line, Pass, ReferenceTool, ToolFrameScene
from cell.formats.laser import LaserData, PassEntry, parse_laser
from cell.formats.reading import read_json

FILE_NAME = "laser.json"
_FAR_M = 20.0
_LONG_M = 2.0


def load_laser(path: Path, *, current: bool = True) -> tuple[Path, LaserData]:
    """The data set at ``path``, its folder or its JSON file; an ``InputError`` names file, field and fix."""
    file = path / FILE_NAME if path.is_dir() else path
    return file, parse_laser(read_json(file), str(file), current=current)


def scene_of(data: LaserData) -> ToolFrameScene:
    """The passes of both sets as the estimator takes them."""
    R = Rotation.from_rotvec(data.R_base_flange).as_matrix()
    beams = {
        "xs": Line.of(data.beams.xs.point, data.beams.xs.dir),
        "ys": Line.of(data.beams.ys.point, data.beams.ys.dir),
    }
    tool = ReferenceTool.of(data.tool.p_ref, data.tool.axis_ref, data.tool.radius)
    passes = [*_passes(data.reference.passes, False), *_passes(data.current.passes, True)]
    return ToolFrameScene(np.asarray(R), beams, tool, passes, data.repeatability_m)


def _passes(entries: Sequence[PassEntry], current: bool) -> list[Pass]:
    """What even the quickest reply takes is the same for all polls and counts to the input's delay: only by
    what others take longer may their times be off (Cristian, "Probabilistic clock synchronization", 1989)."""
    quickest = min((min(e.poll_dt) for e in entries if e.poll_dt), default=0.0)
    return [
        Pass(
            index=k,
            current=current,
            beam=e.beam,
            direction=e.dir,
            pose_t=np.array(e.pose_t),
            pose_xyz=np.array(e.pose_xyz),
            poll_t=np.array(e.poll_t),
            poll_v=np.array(e.poll_v) != 0,
            poll_n=None if e.poll_n is None else np.array(e.poll_n, dtype=np.int64),
            poll_dt=None if e.poll_dt is None else np.array(e.poll_dt) - quickest,
        )
        for k, e in enumerate(entries)
    ]


def unit_warnings(data: LaserData) -> list[tuple[str, str]]:
    """Lengths and angles that are probably millimetres and degrees."""
    found = []
    far = [
        f"{name}.passes[{k}].pose_xyz"
        for name, group in (("reference", data.reference), ("current", data.current))
        for k, e in enumerate(group.passes)
        if float(np.max(np.abs(e.pose_xyz))) > _FAR_M
    ]
    if far:
        found.append(
            (
                "units.translation",
                f"{far[0]} is more than {_FAR_M:.0f} m from the base ({len(far)} such): are the lengths in "
                "millimetres?",
            )
        )
    if float(np.linalg.norm(data.tool.p_ref)) > _LONG_M:
        found.append(
            ("units.translation", f"tool.p_ref is more than {_LONG_M:.0f} m long: is it in millimetres?")
        )
    if float(np.linalg.norm(data.R_base_flange)) > 4.0 * np.pi:
        found.append(("units.rotation", "R_base_flange is beyond 4 pi rad: is it in degrees?"))
    return found
