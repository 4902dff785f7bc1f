"""The lengths and angles that 95 % of the errors of a pose stay below."""

from dataclasses import dataclass

import numpy as np

from calibration.lengths import length95
from cell.poses import Array


@dataclass(frozen=True, eq=False)
class PredictedUncertainty:
    """Expected error of X (T_flange_camera, or T_base_camera for eye-to-hand)."""

    cov: Array  # (6, 6) translation first, right perturbation, m and rad

    @property
    def sigma_t_m(self) -> float:
        """RMS translation error."""
        return float(np.sqrt(np.trace(self.cov[:3, :3])))

    @property
    def sigma_r_rad(self) -> float:
        """RMS rotation error."""
        return float(np.sqrt(np.trace(self.cov[3:, 3:])))

    @property
    def error95_t_m(self) -> float:
        """The length that 95 % of translation errors stay below."""
        return length95(self.cov[:3, :3])

    @property
    def error95_r_rad(self) -> float:
        """The angle that 95 % of rotation errors stay below."""
        return length95(self.cov[3:, 3:])
