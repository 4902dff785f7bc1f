"""Two measurements of a tool against each other."""

import numpy as np

from cell.errors import error
from procedures.laser.result import LaserResult
from procedures.pose_comparison import PoseComparison, require_covariances, weighed


def compare_laser(first: LaserResult, second: LaserResult, false_alarm: float) -> PoseComparison:
    """Tilts are small, so that their rotation vectors are subtracted; without both, only the point counts."""
    cov_a, cov_b = require_covariances(first.result.cov, second.result.cov)
    tools = first.inputs.tool, second.inputs.tool
    if tools[0] != tools[1]:
        raise error("ARGUMENT_INVALID", f"one run measured tool '{tools[0]}', the other '{tools[1]}'")
    turned = first.result.drot_flange, second.result.drot_flange
    xi, cov = np.zeros(6), cov_a + cov_b
    xi[:3] = np.subtract(second.result.dp_flange, first.result.dp_flange)
    seen = np.eye(6)[:, :3]
    if turned[0] is None or turned[1] is None:
        cov[3:, :] = cov[:, 3:] = 0.0
    else:
        xi[3:] = np.subtract(turned[1], turned[0])
        seen = np.zeros((6, 5))
        seen[:3, :3] = np.eye(3)
        # The spin about the tool's axis is in no measurement; it is the direction without any error.
        seen[3:, 3:] = np.linalg.eigh(cov[3:, 3:])[1][:, 1:]
    points = first.result.dp_flange, second.result.dp_flange
    return weighed("dp_flange", "the flange", xi, cov, seen, false_alarm, points)
