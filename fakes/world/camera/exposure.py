"""How long a camera exposes by itself, and at which times what moves is drawn into one exposure."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from cell.formats.reading import Strict
from cell.poses import Array

_METER = 250.0  # lx s: the constant of ISO 2720 for light that falls on a flat receptor
_SHARP_PX, _MOST = 1.0 / 3.0, 31  # a picture that moves less is one instant; times in one exposure


@dataclass(frozen=True)
class Exposure:
    """``time_s`` of each row, and the brightness of the picture relative to a normal one."""

    time_s: float
    gain: float = 1.0


class AutoExposureTruth(Strict):
    """``[world.camera.auto_exposure]``: the time that the light needs, up to the frame's; then the
    sensitivity is raised (both as Luxonis says of its cameras), and then pictures are dark."""

    light_lux: float = Field(
        default=300.0, gt=0, le=200_000, description="on the scene; EN 12464-1 has 300 where goods are packed"
    )
    f_number: float = Field(default=1.8, gt=0.5, le=32, description="of the lens; OAK-D's colour camera")
    iso: float = Field(default=100.0, gt=0, le=10_000, description="the least sensitivity; depthai's")
    most_iso: float = Field(default=1600.0, gt=0, le=100_000, description="the largest; depthai's")

    def exposure(self, period_s: float, light: float) -> Exposure:
        """Of frames that come every ``period_s``, in ``light`` times the light of the scene.

        The time is that of ISO 2720: 250 lx s times the square of the f-number, by light and sensitivity.
        """
        wanted = _METER * self.f_number**2 / (self.light_lux * max(light, 1e-9) * self.iso)
        time_s = min(wanted, period_s)
        return Exposure(time_s, min(time_s * max(self.most_iso / self.iso, 1.0) / wanted, 1.0))


def times_in(t: float, time_s: float, smear_px: float) -> Array:
    """Middles of equal parts of an exposure around ``t``, an odd number: the middle one is ``t``.

    ``smear_px`` is how far the picture moves meanwhile: a part for each pixel, as far as that goes.
    """
    if smear_px < _SHARP_PX:
        return np.array([t])
    parts = int(np.clip(np.ceil(smear_px), 3, _MOST)) | 1
    return np.asarray(t + time_s * ((np.arange(parts) + 0.5) / parts - 0.5))
