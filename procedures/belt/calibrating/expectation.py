"""What ``cellward check`` expects of a belt calibration, by the configuration alone."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from cell.poses import from_pose6
from procedures.belt.calibrating.config import BeltCalibrationConfig
from procedures.belt.setup_checks import needs_depth
from procedures.setup import Setup

# What the depth of a stereo pair 0.8 m above a belt leaves of 95 % intervals, by docs/jobs/belt.md: steps of
# disparity and whole millimetres are alike for all items at one place of the picture. Of the 0.10 % there,
# 0.06 % are the distance's. It is not known for other heights, so the words name this one.
_BY_DEPTH = {"scale_share": 0.0008, "rise_rad": 0.0034}


def calibration_expectation(setup: Setup, job: BeltCalibrationConfig) -> dict[str, Any]:
    """``text``, what keeps the job from its answer (``problems``), and limits that it will miss
    (``cautions``). ``leaves`` has the least halves of 95 % intervals, with which limits are compared:
    ``scale_share``, ``level_rad`` and ``rise_rad``."""
    if job.source == "touch":
        problems = setup.missing("belt", "arm")
        text = f"{job.touches} touches of a mark, and the belt runs between them"
        return {"text": problems[0] if problems else text, "problems": problems, "cautions": []}
    problems = [*setup.missing("belt", "fixed_camera"), *needs_depth(setup, "belt-calibration", job.items)]
    if problems:
        return {"text": problems[0], "problems": problems, "cautions": []}
    least = _left_open(setup, job)
    text = f"items on {job.travel_m:g} m of a running belt, {job.sightings} sightings at least"
    if "scale_share" in least:
        text += f"; m_per_count at best to {100 * least['scale_share']:.3f} % (95 %)"
    text += (
        f", dir at best to {1e3 * least['level_rad']:.1f} mrad seen from above and "
        f"{1e3 * least['rise_rad']:.1f} mrad of its rise, however many items pass"
    )
    if job.items.height_m is None:
        text += " (by depth as of a pair 0.8 m above)"
    return {"text": text, "leaves": least, "problems": [], "cautions": list(_too_tight(job, least))}


def _left_open(setup: Setup, job: BeltCalibrationConfig) -> dict[str, float]:
    """What no number of items makes smaller: what is said of the camera's place, and steps of its depth."""
    least = {"level_rad": job.camera_turn_95_rad, "rise_rad": job.camera_turn_95_rad}
    nominal = setup.nominal["T_base_camera_nominal"]
    height = 0.0 if nominal is None else float(from_pose6(nominal).translation[2]) - (job.belt_z_m or 0.0)
    if height > 0.0:
        least["scale_share"] = job.distance_95_m / height
    if job.items.height_m is None:
        least |= {of: float(np.hypot(least[of], left)) for of, left in _BY_DEPTH.items() if of in least}
    return least


def _too_tight(job: BeltCalibrationConfig, least: dict[str, float]) -> Iterator[str]:
    """Limits below that: the answer would be proposed with a warning each time."""
    for key, of, unit, factor in (
        ("max_scale_share", "scale_share", "%", 100.0),
        ("max_dir_rad", "level_rad", "mrad", 1e3),
        ("max_rise_rad", "rise_rad", "mrad", 1e3),
    ):
        if (limit := getattr(job.accept, key)) >= (leaves := least.get(of, 0.0)):
            continue
        known = "distance_95_m" if of == "scale_share" else "camera_turn_95_rad"
        better = f"measure the camera's place better and lower {known}"
        by_depth = _BY_DEPTH.get(of, 0.0) if job.items.height_m is None else 0.0
        if 2.0 * by_depth**2 > leaves**2:
            better = (
                "give items.height_m where all items are as high: most is left by the steps of its depth, as "
                "of a pair 0.8 m above"
            )
        yield (
            f"accept.{key} = {limit:g} is {factor * limit:g} {unit}, and the camera leaves "
            f"{factor * leaves:.2g} {unit} (95 %) open however many items pass: raise the limit, or {better}"
        )
