"""A capture as another arm would have reported it: flange poses from the stored joints."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.kinematics.families import arm_spec
from cell.errors import error
from cell.formats.reading import read_json
from cell.formats.robot import parse_robot
from procedures.hand_eye.solve.capture import CaptureSet


def with_robot(loaded: CaptureSet, robot: Path | Mapping[str, Any]) -> None:
    """Put a ROBOT in place of the capture's, and its flange poses in place of the reported ones.

    ``robot`` is a file, which may be a result that holds one, or the document itself. ``DATA_INVALID`` where
    an observation has no joints.
    """
    raw, where = (robot, "robot") if isinstance(robot, Mapping) else (read_json(robot), str(robot))
    for key in ("result", "robot"):
        inner = raw.get(key)
        raw = inner if isinstance(inner, Mapping) else raw
    document = {key: value for key, value in raw.items() if key != "schema"}
    spec = arm_spec(parse_robot(document, where), where)
    joints = []
    for observation in loaded.capture.observations:
        if observation.q is None or len(observation.q) != spec.arm.joints:
            has = "no q" if observation.q is None else f"a q of {len(observation.q)} numbers"
            raise error(
                "DATA_INVALID",
                f"{loaded.path}: observation {observation.index} has {has}; with another robot the "
                f"flange poses come from the joints, and this one has {spec.arm.joints}",
            )
        joints.append(observation.q)
    loaded.F = spec.arm.base.flange(np.array(joints, dtype=float))
    loaded.capture = loaded.capture.model_copy(update={"robot": document})
