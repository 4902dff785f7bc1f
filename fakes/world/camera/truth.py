"""The tables of a scenario that describe a camera, and the target that it looks at."""

from itertools import zip_longest
from math import pi
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from cell.devices import Intrinsics
from cell.formats.reading import Strict
from cell.poses import Array
from fakes.world.arm.truth import Six
from fakes.world.camera.exposure import AutoExposureTruth, Exposure

Two = Annotated[list[float], Field(min_length=2, max_length=2)]
_MODELS = (0, 4, 5, 8, 12, 14)


class ToldTruth(Strict):
    """``[world.camera.told]``: how far the intrinsics that the camera tells are off its true lens.

    They are ``f (1 + focal)``, ``c + centre_px`` and ``dist + this dist``; pictures come from the true ones.
    """

    focal: float = Field(default=0.0, gt=-0.5, lt=0.5, description="share of both focal lengths")
    centre_px: Two = Field(default=[0.0, 0.0])
    dist: list[float] = Field(default=[], description="added to dist, entry by entry")


# Noise of a disparity where it is interpolated between neighbours, root mean square.
_BETWEEN = 2.0 / 3.0
_NODES = np.linspace(-4.0, 4.0, 161)  # of a normal distribution, in standard deviations
_WEIGHTS = np.exp(-0.5 * _NODES**2) / np.sum(np.exp(-0.5 * _NODES**2))


class StereoTruth(Strict):
    """``[world.camera.stereo]``: depth as a stereo pair makes it, :mod:`fakes.frames.stereo`."""

    focal_px: float = Field(default=440.0, gt=0, description="of the pictures that are matched")
    baseline_m: float = Field(default=0.075, gt=0, le=1)
    steps: int = Field(default=8, ge=1, le=64, description="of disparity in a pixel")
    noise_px: float = Field(default=0.1, ge=0, le=5, description="sigma of the disparity")
    holes: float = Field(default=0.0, ge=0, lt=1, description="share of the picture that has no depth")
    scale: float = Field(default=1.0, gt=0.5, lt=2, description="of what is told")

    def depth_sigma_m(self, depth_m: float) -> float:
        """Of a depth before it is scaled (m), by the noise of its disparity and by the steps of that, which
        leave a step over the root of 12."""
        disparity_px = float(np.hypot(self.noise_px, 1.0 / (self.steps * np.sqrt(12.0))))
        return self._m_per_px(depth_m) * disparity_px

    def common_step_m(self, depth_m: float, spread_m: float) -> float:
        """What of it the steps do to all of a face whose own depths have the standard deviation ``spread_m``.

        Noise and spread, as one normal distribution of sigma s, move disparities across steps of q. The mean
        of what is rounded is off by the harmonics of the steps, each q / (pi k sqrt(2)) exp(-2 (pi k s/q)^2),
        root mean square over where in a step the face lies (Widrow and Kollar, Quantization Noise, 2008): by
        q / sqrt(12) where s is none, and by less than 1 % of that where s is half a step.
        """
        k, q = np.arange(1, 40), 1.0 / self.steps
        s = np.hypot(_BETWEEN * self.noise_px, spread_m / self._m_per_px(depth_m))
        harmonics = q / (np.pi * k * np.sqrt(2.0)) * np.exp(-2.0 * (np.pi * k * s / q) ** 2)
        return self._m_per_px(depth_m) * float(np.linalg.norm(harmonics))

    def told_off_m(self, depth_m: float, spread_m: float) -> float:
        """By how much the mean of a face's told depths is off ``depth_m``, of which they are told ``scale``
        times, where its own depths have the standard deviation ``spread_m``.

        Steps of disparity are told in whole millimetres. Noise and spread average over the steps, and each of
        these steps is off by its own rounding all the same: where a millimetre and a step drift along each
        other, over some centimetres of depth, the mean is off by up to 0.4 mm. It is alike in all pictures.
        """
        s = np.hypot(_BETWEEN * self.noise_px, spread_m / self._m_per_px(depth_m))
        product = 1000.0 * self.focal_px * self.baseline_m  # px mm
        disparity = np.round(self.steps * (product / (1000.0 * depth_m) + s * _NODES)) / self.steps
        told = np.floor(self.scale * product / np.maximum(disparity, 1.0 / self.steps) + 0.5)
        return float(1e-3 * (_WEIGHTS @ told) - self.scale * depth_m)

    def _m_per_px(self, depth_m: float) -> float:
        """Depth by disparity."""
        return depth_m**2 / (self.focal_px * self.baseline_m)


class CameraTruth(Strict):
    """The camera and where it truly is; ``nominal`` is the nominal value of the same pose."""

    serial: str = Field(
        default="99992200001", pattern=r"^9999\d+$", description="twin serials begin with 9999"
    )
    width: int = Field(default=1280, ge=64, le=8192)
    height: int = Field(default=800, ge=64, le=8192)
    K: Annotated[list[float], Field(min_length=4, max_length=4)]
    dist: list[float] = Field(default=[])
    told: ToldTruth = ToldTruth()
    T_flange_camera: Six | None = None
    T_base_camera: Six | None = None
    nominal: Six
    noise_px: float = Field(default=0.05, ge=0, le=10, description="of a corner, where no picture is drawn")
    noise_grey: float = Field(default=2.0, ge=0, le=50, description="sigma of a drawn picture's pixels")
    blur_px: float = Field(default=0.7, ge=0, le=5, description="sigma, of a drawn target")
    vignette: float = Field(default=0.0, ge=0, lt=1, description="share of light lost in a picture's corners")
    row_time_s: float = Field(
        default=0.0, ge=0, le=0.0002, description="from row to row; the stamp is that of the first. 0: global"
    )
    stamp_late_s: float = Field(
        default=0.0, ge=-0.2, le=0.2, description="by which the told stamp is behind the exposure"
    )
    stamp_jitter_s: float = Field(default=0.0, ge=0, le=0.01, description="sigma of the told stamp")
    autofocus: bool = Field(
        default=False, description="the lens moves all the time, and with it what it makes of the picture"
    )
    depth: bool = Field(default=True, description="false: a camera that gives colour alone, as an OAK-1")
    stereo: StereoTruth | None = Field(default=None, description="absent: depth with a millimetre of noise")
    exposure_s: float = Field(default=0.008, gt=0, le=1, description="fixed, where it is not automatic")
    auto_exposure: AutoExposureTruth | None = Field(default=None, description="by the light; absent: fixed")
    period_s: float = Field(default=0.1, gt=0, le=10)
    latency_s: float = Field(default=0.03, ge=0, le=1, description="from mid exposure to delivery")
    grey: float = Field(default=120.0, ge=0, le=255)

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if (self.T_flange_camera is None) == (self.T_base_camera is None):
            raise ValueError("give either T_flange_camera (eye-in-hand) or T_base_camera (eye-to-hand)")
        if not self.depth and self.stereo is not None:
            raise ValueError("depth = false has no stereo pair: leave [world.camera.stereo] out, or depth")
        for name, dist in (("dist", self.dist), ("told.dist", self.told.dist)):
            if len(dist) not in _MODELS:
                raise ValueError(f"{name} has {len(dist)} entries; OpenCV's models have 0, 4, 5, 8, 12 or 14")
        return self

    def row_delay_s(self, points: Array) -> Array:
        """How long after the first row those rows are exposed on which ``points`` (..., 3) of the camera lie.

        Without the lens's distortion, which shifts a row by some millionths of a second.
        """
        rows = self.K[1] * points[..., 1] / points[..., 2] + self.K[3]
        return np.asarray(self.row_time_s * np.clip(rows, 0.0, self.height))

    def exposure(self, light: float = 1.0) -> Exposure:
        """What a frame is exposed with in ``light`` times the light of the scene."""
        if self.auto_exposure is None:
            return Exposure(self.exposure_s, light)
        return self.auto_exposure.exposure(self.period_s, light)

    def true_lens(self) -> Intrinsics:
        """Intrinsics that make the pictures."""
        fx, fy, cx, cy = self.K
        return Intrinsics(self.width, self.height, (fx, fy, cx, cy), tuple(self.dist))

    def told_lens(self) -> Intrinsics:
        """Intrinsics that the camera tells: in a frame's header, and as its own calibration."""
        fx, fy, cx, cy = self.K
        f, (dx, dy) = 1.0 + self.told.focal, self.told.centre_px
        dist = tuple(a + b for a, b in zip_longest(self.dist, self.told.dist, fillvalue=0.0))
        return Intrinsics(self.width, self.height, (f * fx, f * fy, cx + dx, cy + dy), dist)


class PrintTruth(Strict):
    """``[world.target_print]``: how far the target that hangs there is off the one of ``[world.target]``."""

    scale_x: float = Field(default=0.0, gt=-0.1, lt=0.1, description="share by which it is too large along x")
    scale_y: float = Field(default=0.0, gt=-0.1, lt=0.1, description="and along y")
    bow_m: float = Field(
        default=0.0, ge=-0.02, le=0.02, description="how far its edges are off its middle along its z"
    )
    bow_rad: float = Field(
        default=0.0, ge=-pi, le=pi, description="direction across the bow, from the target's x to its y"
    )


class Placement(Strict):
    """Where the operator puts the target: in the base, or on the flange when the camera is fixed."""

    T_base_target: Six | None = None
    T_flange_target: Six | None = None
