"""Two measurements of a tool against each other."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cell.errors import error
from procedures.pose_comparison import PoseComparison, require_covariances, weighed


def compare_laser(first: Mapping[str, Any], second: Mapping[str, Any]) -> PoseComparison:
    """Tilts are small, so that their rotation vectors are subtracted; without both, only the point counts."""
    require_covariances(first, second)
    tools = [(document.get("inputs") or {}).get("tool") for document in (first, second)]
    if tools[0] != tools[1]:
        raise error("ARGUMENT_INVALID", f"one run measured tool '{tools[0]}', the other '{tools[1]}'")
    answers = first["result"], second["result"]
    turned = [answer.get("drot_flange") for answer in answers]
    xi, cov = np.zeros(6), np.sum([np.array(answer["cov"]) for answer in answers], axis=0)
    xi[:3] = np.subtract(answers[1]["dp_flange"], answers[0]["dp_flange"])
    seen = np.eye(6)[:, :3]
    if None in turned:
        cov[3:, :] = cov[:, 3:] = 0.0
    else:
        xi[3:] = np.subtract(turned[1], turned[0])
        seen = np.zeros((6, 5))
        seen[:3, :3] = np.eye(3)
        # The spin about the tool's axis is in no measurement; it is the direction without any error.
        seen[3:, 3:] = np.linalg.eigh(cov[3:, 3:])[1][:, 1:]
    return weighed("dp_flange", "the flange", xi, cov, seen)
