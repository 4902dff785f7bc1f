"""How far contacts may be off by what is known before a run: calibrations, and few sightings."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from calibration.belt.items import CAMERA_SIGMA
from calibration.belt.placing import camera_cov, left_open
from cell.calibrations import belt_scale, time_offset
from cell.devices import Intrinsics
from cell.errors import CellError
from cell.poses import Array, from_pose6
from procedures.belt.camera_to_belt import NAME as CAMERA_POSE
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.contact_uncertainty import (
    BELT,
    CAMERA,
    DELAYS,
    NO_CAMERA,
    SIGHTINGS,
    ContactError,
    belt_sigmas,
)
from procedures.belt.motion.cycle_estimate import SPEEDS_M_S
from procedures.belt.stamp_delays import CAMERA_ROLE, ENCODER_ROLE, MEASURE, StampDelays
from procedures.report.numbers import K95
from procedures.setup import Setup
from procedures.words import mm

_NOT_YET = "what the belt does meanwhile, how the arm follows, and its own accuracy"
_NOT_SEEN = "scale and direction of the belt, as no nominal pose of the camera says where items are seen"
_SMEARED = "the smear of a camera that exposes by itself (exposure_s is not given)"


def expected_contacts(setup: Setup, job: BeltTrackingConfig) -> dict[str, Any]:
    """``contacts``: the 95 % (m) for each speed of the belt, with its parts, what is ``assumed`` and what is
    ``without``; the ``text`` of it, and ``cautions`` where it is beyond ``following_limit_m``."""
    try:
        known = _Known(setup, job)
    except CellError:  # a ledger that cannot be read is told of elsewhere
        return {"contacts": None, "text": "no prediction of contacts without the ledger", "cautions": []}
    rows = [(v, known.at(v)) for v in SPEEDS_M_S]
    figures = ", ".join(f"{mm(found.r95_m)} at {v:g} m/s" for v, found in rows)
    limit, sightings = job.following_limit_m, f"{job.min_sightings} sightings of {mm(CAMERA_SIGMA, 1)}"
    return {
        "contacts": [{"speed_m_s": v, **found.as_dict()} for v, found in rows],
        "assumed": known.assumed,
        "without": known.without,
        "text": f"95 of 100 contacts within {figures} by {sightings} each, as of a camera that nobody has "
        f"watched yet, and what calibrations state{_assumed(known)}{_without(known)}",
        "cautions": list(_beyond(rows, limit)),
    }


def _assumed(known: "_Known") -> str:
    measured = zip(known.assumed, known.measured_by, strict=True)
    parts = [f"{what}, which {by} measures" for what, by in measured]
    return f", and by an assumption {'; and by an assumption '.join(parts)}" if parts else ""


def _without(known: "_Known") -> str:
    """Each with its head: a clause of a prediction is shown on a line of its own."""
    return "".join(f"; not in it: {what}" for what in known.without)


def _beyond(rows: list[tuple[float, ContactError]], limit_m: float) -> Iterator[str]:
    for v, found in rows:
        if found.r95_m > limit_m:
            parts = {name: float(np.trace(cov)) for name, cov in found.parts.items()}
            yield (
                f"at {v:g} m/s contacts may be off by {mm(found.r95_m)} (95 %), following_limit_m is "
                f"{mm(limit_m)}; mostly by {max(parts, key=lambda name: parts[name])}: calibrate it better"
            )
            return


class _Known:
    """What calibrations state now, as of an item that was seen below the camera and is met in mid-zone."""

    def __init__(self, setup: Setup, job: BeltTrackingConfig) -> None:
        belt = setup.values.belt or {}
        way = np.array(belt["dir"], dtype=float)[:2]
        self._along, self._sightings = way / np.linalg.norm(way), job.min_sightings
        seen = _below_camera(setup, job)
        self._camera = None if seen is None else _camera(setup, job, seen)
        name = belt_scale(setup.roles[ENCODER_ROLE])
        in_effect = setup.committed(name) is not None
        self._belt = belt_sigmas(setup.stated(name), belt, in_effect=in_effect)
        middle = 0.5 * (job.zone.min_m + job.zone.max_m)
        self._moved = None if seen is None else middle - float(seen[:2] @ self._along)
        delays = StampDelays({role: _delay(setup, role) for role in (CAMERA_ROLE, ENCODER_ROLE)})
        self._delays = delays
        of_belt = self._belt.assumption
        assumed = {} if of_belt is None else {of_belt.words: of_belt.measured_by}
        if not delays.camera_measured:  # an even speed asks no count
            assumed[delays.assumed()[0]] = MEASURE.format(CAMERA_ROLE)
        self.assumed, self.measured_by = list(assumed), list(assumed.values())
        exposure = getattr(setup.devices.get(setup.roles[CAMERA_ROLE]), "exposure_s", 0.0)
        self.without = [
            *([NO_CAMERA] if self._camera is None else []),
            *([_NOT_SEEN] if seen is None else []),
            *([] if of_belt is None else [of_belt.larger]),
            *([_SMEARED] if exposure is None else []),
            _NOT_YET,
        ]

    def at(self, speed_m_s: float) -> ContactError:
        """On a belt so fast."""
        u = self._along
        along, across = np.outer(u, u), np.outer([-u[1], u[0]], [-u[1], u[0]])
        parts = {SIGHTINGS: CAMERA_SIGMA**2 / self._sightings * np.eye(2)}
        if self._camera is not None:
            parts[CAMERA] = self._camera
        if self._moved is not None:
            parts[BELT] = self._moved**2 * self._belt.cov(along, across)
        parts[DELAYS] = self._delays.variance(speed_m_s, speed_m_s) * along
        return ContactError(parts)


def _delay(setup: Setup, role: str) -> dict[str, float]:
    """As of ``RunValues.time_offset_s``: the standard deviation of a delay that was measured."""
    interval = setup.stated(time_offset(setup.roles[role])).get("interval95_s")
    return {} if interval is None else {"sigma": 0.5 * (interval[1] - interval[0]) / K95}


def _below_camera(setup: Setup, job: BeltTrackingConfig) -> Array | None:
    """(3,) m: where the nominal camera looks at the belt; None without one that looks down on it."""
    nominal = setup.nominal.get("T_base_camera_nominal")
    if nominal is None:
        return None
    T = from_pose6(nominal)
    sight = T.rotation.apply([0.0, 0.0, 1.0])
    if sight[2] >= 0.0 or (below := float(T.translation[2]) - job.belt_z_m) <= 0.0:
        return None
    return np.asarray(T.translation - below / sight[2] * sight)


def _camera(setup: Setup, job: BeltTrackingConfig, seen: Array) -> Array | None:
    stated, nominal = setup.stated(CAMERA_POSE), setup.nominal["T_base_camera_nominal"]
    found = stated.get("lens")
    if found is None or nominal is None or "cov" not in stated or "budget" not in stated:
        return None
    fx, fy, cx, cy = found["K"]
    lens = Intrinsics(found["width"], found["height"], (fx, fy, cx, cy), tuple(found["dist"]))
    cov = camera_cov(np.array(stated["cov"]), stated.get("lens_cov"), None)
    return left_open(seen[None], from_pose6(nominal), lens, np.asarray(cov))
