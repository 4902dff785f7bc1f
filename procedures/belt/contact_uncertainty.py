"""How far a contact may be off, level, by everything that is known to leave it open, source by source.

What all contacts share (camera, belt calibration, delays, arm) is in the figure of each, so that it holds for
any of them; it does not get less with their number.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calibration.belt.forecast import TravelForecast
from calibration.belt.tracking import ItemTrack
from calibration.lengths import length95
from cell.poses import Array
from cell.run_values import RunValues
from cell.usual_belt import SCALE_SHARE, TURN_RAD
from procedures.belt.camera_to_belt import NAME as CAMERA_POSE
from procedures.belt.camera_to_belt import CameraToBelt
from procedures.belt.stamp_delays import StampDelays
from procedures.hand_eye_in_use import arm_rms_m
from procedures.report.numbers import K95

SIGHTINGS, MOTION, BELT, CAMERA = "sightings", "belt motion", "belt calibration", "camera"
DELAYS, FOLLOWING, PLAN, ARM = "delays", "following", "plan", "arm"
NO_CAMERA = "the camera's pose and lens, of which no covariance is known"
LARGER_DELAYS = (
    "larger delays than are assumed: of a camera whose driver stamps pictures as they arrive, of a USB "
    "adapter whose latency timer is left at 16 ms, of a controller of 125 Hz"
)
NOT_CALIBRATED = (
    f"the configured travel of one count as off by {100 * SCALE_SHARE:g} % and the configured direction by "
    f"{1e3 * TURN_RAD:g} mrad (root mean square)"
)
CALIBRATE = "`cellward start belt-calibration`"
WITHOUT_INTERVAL = (
    f"the belt, which was calibrated without an interval, as off by {100 * SCALE_SHARE:g} % of the travel of "
    f"one count and {1e3 * TURN_RAD:g} mrad of the direction (root mean square)"
)
_NEVER = (
    "how an item lies in the gripper and what the fingers do to it",
    "a belt that is not as high as belt_z_m says",
    "an error of row_time_s, where the shutter of the camera is a rolling one",
)
_SPEED_S = 0.01  # over which a speed of the past is taken


@dataclass(frozen=True)
class ContactError:
    """Covariances (2, 2), m^2, of where an item is beside the tool at contact, x and y in the base."""

    parts: Mapping[str, Array]

    @property
    def cov(self) -> Array:
        """Of all parts together."""
        return np.asarray(sum(self.parts.values(), np.zeros((2, 2))))

    @property
    def r95_m(self) -> float:
        """So far off, level, is a contact in 95 of 100 cases, m."""
        return length95(self.cov)

    def as_dict(self) -> dict[str, object]:
        """For an item's life: all together, and each part alone, m."""
        parts = {name: round(length95(cov), 9) for name, cov in self.parts.items()}
        return {"contact_95_m": round(self.r95_m, 9), "contact_parts_95_m": parts}


@dataclass(frozen=True)
class Touch:
    """A contact as it was planned: when, where the tool is then (2,) in the base, and the item as it was
    predicted at that decision."""

    t: float
    xy: Array
    track: ItemTrack


class ContactBudget:
    """Of one run: what its calibrations leave open, to be put beside what each contact does."""

    def __init__(self, values: RunValues, camera_to_belt: CameraToBelt) -> None:
        self._camera = camera_to_belt
        belt = next((name for name in values.versions if name.startswith("belt.")), "")
        self._belt = belt_sigmas(values.uncertainty.get(belt, {}), values.belt, in_effect=bool(belt))
        self.delays = StampDelays(values.time_offset_s)
        self._arm_m = arm_rms_m(values, CAMERA_POSE)
        self.camera_known = self.followed = True

    def of(self, touch: Touch, seen: Array, following: Array | None) -> ContactError:
        """``seen`` (k, 3) m are the item's sightings in the base, ``following`` (2, 2) m^2 the mean square of
        tool beside set-point."""
        track, t = touch.track, touch.t
        u = track.unit
        along, across = np.outer(u, u), np.outer([-u[1], u[0]], [-u[1], u[0]])
        place, forecast = track.place, track.forecast
        flat = float(np.linalg.norm(track.flat))
        moved, speeds = _since_sightings(track, t, flat)
        beside = track.xy(np.array([t]))[0] - touch.xy
        parts = {
            SIGHTINGS: place.var_along * along + place.var_across * across,
            MOTION: (forecast.sigma(place.at, t) * flat) ** 2 * along,
            PLAN: np.outer(beside, beside),
            BELT: moved**2 * self._belt.cov(along, across),
        }
        camera = self._camera.left_open(seen)
        if camera is not None:
            parts[CAMERA] = camera
        self.delays.met(*speeds)
        parts[DELAYS] = self.delays.variance(*speeds) * along
        if following is not None:
            parts[FOLLOWING] = following
        if self._arm_m is not None:
            parts[ARM] = self._arm_m**2 / 3.0 * np.eye(2)
        self.camera_known, self.followed = camera is not None, following is not None
        return ContactError(parts)

    def assumed(self) -> list[str]:
        """In words, what the figures have by an assumption, as it was not measured."""
        of_belt = self._belt.assumption
        return [*([] if of_belt is None else [of_belt.words]), *self.delays.assumed()]

    def not_covered(self) -> list[str]:
        """What the figures leave out, in words: for want of a measurement, or as nothing here sees it."""
        out = []
        if self._arm_m is None:
            out.append("the arm's own accuracy, which was not measured")
        if not self.camera_known:
            out.append(NO_CAMERA)
        if self._belt.assumption is not None:
            out.append(self._belt.assumption.larger)
        if not self.followed:
            out.append("how the arm follows its set-points, which no grip has shown")
        if self.delays.assumed():
            out.append(LARGER_DELAYS)
        return [*out, *_NEVER]


def together(errors: Sequence[ContactError]) -> ContactError | None:
    """The mean of several contacts: 95 of 100 of them all are within its figure. None without any."""
    if not errors:
        return None
    names = dict.fromkeys(name for error in errors for name in error.parts)
    zero = np.zeros((2, 2))
    return ContactError(
        {name: np.mean([error.parts.get(name, zero) for error in errors], axis=0) for name in names}
    )


def shares(error: ContactError) -> dict[str, float]:
    """By source, the share of the mean square error, largest first."""
    whole = float(np.trace(error.cov))
    parts = {name: float(np.trace(cov)) / whole for name, cov in error.parts.items()} if whole > 0.0 else {}
    return dict(sorted(parts.items(), key=lambda part: -part[1]))


def _since_sightings(track: ItemTrack, t: float, flat: float) -> tuple[float, tuple[float, float]]:
    """How far the belt goes from the mean of the item's sightings to ``t``, m, and its speeds (m/s) over
    ground at them, on average, and at ``t``."""
    exposed = np.array([s.t for s, used in zip(track.sightings, track.place.used, strict=True) if used])
    forecast = track.forecast
    moved = forecast.travels_at(t) - float(np.mean(forecast.travelled(exposed)))
    ends = forecast.travelled(exposed + _SPEED_S) - forecast.travelled(exposed - _SPEED_S)
    return flat * moved, (flat * float(np.mean(ends)) / (2.0 * _SPEED_S), flat * _speed_at(forecast, t))


def _speed_at(forecast: TravelForecast, t: float) -> float:
    return forecast.speed(max(t, forecast.now))


class BeltAssumption(NamedTuple):
    """In words, what counts where nothing is stated of a belt, what of it is not covered, and what measures
    it."""

    words: str
    larger: str
    measured_by: str


NOMINAL_BELT = BeltAssumption(
    NOT_CALIBRATED,
    "a belt that is further from its configured travel and direction than is assumed",
    CALIBRATE,
)
UNSTATED_BELT = BeltAssumption(
    WITHOUT_INTERVAL,
    "a belt that is further from its calibrated travel and direction than is assumed",
    f"another {CALIBRATE}",
)


class BeltSigmas(NamedTuple):
    """Standard deviations of a belt's scale, as a share of it, and of its direction, level, rad; with the
    ``assumption`` that they are by, None where they were stated."""

    scale: float
    turn: float
    assumption: BeltAssumption | None

    def cov(self, along: Array, across: Array) -> Array:
        """(2, 2), m^2 for a way of one metre; ``along`` and ``across`` (2, 2) project onto these axes."""
        return np.asarray(self.scale**2 * along + self.turn**2 * across)


def belt_sigmas(stated: Mapping[str, Any], belt: Mapping[str, Any] | None, *, in_effect: bool) -> BeltSigmas:
    """Of ``belt``, from what its calibration has ``stated``; where that is nothing the usual, of a version
    ``in_effect`` as well."""
    interval, turn = stated.get("m_per_count_95"), stated.get("dir_95_rad")
    turn = stated.get("half_level_rad", turn)  # dir_95_rad is of height as well, which moves no contact
    if interval is None or turn is None or belt is None:
        return BeltSigmas(SCALE_SHARE, TURN_RAD, UNSTATED_BELT if in_effect else NOMINAL_BELT)
    half = 0.5 * abs(float(interval[1]) - float(interval[0]))
    return BeltSigmas(half / abs(float(belt["m_per_count"])) / K95, float(turn) / K95, None)
