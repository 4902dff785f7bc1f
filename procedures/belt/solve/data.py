"""An intercept data set in memory, in the order in which its data came to be known."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.belt.arm_time import MotionLimits
from calibration.belt.estimator import EncoderScale
from calibration.belt.items import Sighting
from calibration.belt.meeting import Zone
from calibration.belt.placing import left_open
from calibration.belt.tracking import RestingArm
from cell.errors import error, present
from cell.formats.intercept import SCHEMA, Detection, Intercept, Query
from cell.formats.reading import parse, read_json
from cell.poses import Array, from_pose6

FILE_NAME = "intercept.json"
UNITS_T = "units.translation"
_FAR = 20.0  # m
_UNIT = 1e-3
_COARSE_M = 0.5e-3  # RMS of a count's rounding; the arm meets items that well at best


@dataclass
class InterceptSet:
    """``t`` (k,) and ``count`` (k,) of the encoder by stamp; ``detections`` by arrival, ``queries`` by time.

    ``direction`` (3,) is the belt's unit vector in base. ``order`` is where each query stands in the file.
    """

    path: Path
    data: Intercept
    encoder: EncoderScale
    direction: Array
    arm: RestingArm
    zone: Zone
    dwell: float
    t: Array
    count: list[int]
    detections: list[Detection]
    queries: list[Query]
    order: NDArray[np.int64]
    warnings: list[tuple[str, str]] = field(default_factory=list)

    def camera_cov(self, places: Array) -> Array | None:
        """(2, 2) m^2 of x, y of an item that was seen at ``places`` (n, 3) m: what the pose and the lens of
        the camera leave open, for all items alike. None where nothing is known of them."""
        camera = self.data.camera
        if camera is None or camera.cov is None:
            return None
        lens = (camera.lens or camera.told).intrinsics()
        return left_open(places, from_pose6(camera.T_base_camera), lens, np.array(camera.cov))

    def sighting(self, detection: Detection) -> Sighting:
        """A detection with its exposure, derived from the mean latency where it is not known."""
        xy, arrived, t = (detection.xy[0], detection.xy[1]), detection.t_recv, detection.t_exp
        if t is not None:
            return Sighting(xy, t, arrived, sure=True, sigma=detection.sigma or 0.0)
        latency = present(self.data.latency_mean, "latency_mean")
        return Sighting(xy, arrived - latency, arrived, sure=False, sigma=detection.sigma or 0.0)


def load_intercept(path: Path) -> InterceptSet:
    """Read and check a data set (its JSON file, or a folder with ``intercept.json``)."""
    file = path / FILE_NAME if path.is_dir() else path
    data = parse(Intercept, read_json(file), SCHEMA, str(file))
    belt, robot, zone = data.belt, data.robot, data.zone
    rows = sorted(data.encoder, key=lambda row: row[0])
    order = np.array(sorted(range(len(data.queries)), key=lambda k: data.queries[k].t), dtype=np.int64)
    direction = np.array([*belt.dir, 0.0][:3])
    limits = robot.limits
    loaded = InterceptSet(
        path=file,
        data=data,
        encoder=EncoderScale(belt.scale, belt.modulus, belt.period),
        direction=direction / np.linalg.norm(direction),
        arm=RestingArm(
            MotionLimits(limits.v, limits.a, limits.j),
            (robot.wait_point[0], robot.wait_point[1]),
            robot.above,
        ),
        zone=Zone(None, None) if zone is None else Zone(zone.min, zone.max),
        dwell=data.dwell_s or 0.0,
        t=np.array([t for t, _ in rows]),
        count=[c for _, c in rows],
        detections=sorted(data.detections, key=lambda d: d.t_recv),
        queries=[data.queries[k] for k in order],
        order=order,
    )
    _check(loaded, float(np.linalg.norm(direction)))
    return loaded


def _check(loaded: InterceptSet, length: float) -> None:
    """What can be told from the file alone: warnings, and one sentence for a file that contradicts itself."""
    data, warn = loaded.data, loaded.warnings
    if abs(length - 1.0) > _UNIT:
        warn.append(("belt.dir", f"belt.dir has the length {length:.4g}; it is used as a unit vector"))
    if (rounding := abs(loaded.encoder.m_per_count) / np.sqrt(12.0)) > _COARSE_M:
        text = f"m_per_count is {loaded.encoder.m_per_count:g} m: the rounding of a count alone is"
        warn.append(("belt.scale", f"{text} {1e3 * rounding:.1f} mm RMS; it is metres of belt for one count"))
    modulus = data.belt.modulus
    beyond = 0 if modulus is None else sum(not -modulus <= c < modulus for c in loaded.count)
    if beyond:
        raise error(
            "DATA_INVALID",
            f"{loaded.path}: {beyond} counts of encoder lie outside of modulus {modulus}; "
            "correct belt.modulus",
        )
    stamps = [t for t, _ in data.encoder]
    if any(b < a for a, b in pairwise(stamps)):
        warn.append(("encoder.order", "encoder is not in the order of its stamps; it was sorted"))
    warn.extend(_spacing(loaded.t, data.belt.period))
    early = [d for d in data.detections if d.t_exp is not None and d.t_exp > d.t_recv]
    if early:
        text = f"{len(early)} detections (first: {early[0].id!r}) were exposed after they arrived"
        warn.append(("detections.early", f"{text}: do t_exp and t_recv come from one clock?"))
    places = [np.abs(d.xy).max() for d in data.detections] + [np.abs(data.robot.wait_point).max()]
    places += [abs(edge) for edge in (loaded.zone.low, loaded.zone.high) if edge is not None]
    if places and max(places) > _FAR:
        text = f"a position is {max(places):.4g} m from the base: are lengths in millimetres?"
        warn.append((UNITS_T, text))


def _spacing(t: Array, period: float) -> Sequence[tuple[str, str]]:
    if len(t) < 3 or t[-1] <= t[0]:
        return []
    steps = np.diff(t)
    usual, longest = float(np.median(steps[steps > 0.0])), int(np.argmax(steps))
    out = []
    if not 0.8 < usual / period < 1.25:
        text = f"counts come every {1e3 * usual:.3g} ms, belt.period says {1e3 * period:.3g} ms"
        out.append(("encoder.period", f"{text}; the stamps were followed"))
    if steps[longest] > max(0.1, 10.0 * usual):
        text = f"no count for {steps[longest]:.2f} s after {t[longest]:.3f} s"
        out.append(("encoder.gap", f"{text}; what the belt did in between is not known"))
    return out
