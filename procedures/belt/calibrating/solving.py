"""Scale and direction of the belt from a data set, within the job's limits: the path of job and replay."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.belt.scale import BeltScale, fit_scale, two_points
from calibration.refusal import Refusal
from cell.formats.intercept import ItemsCamera
from cell.formats.reading import parse_part
from cell.formats.result import Result, Verdict, Warning_
from cell.poses import Array
from procedures.belt.calibrating.config import Acceptance
from procedures.belt.calibrating.delay import DELAY, with_delay
from procedures.belt.calibrating.record import read_data_set
from procedures.belt.calibrating.rows import SightingRows, parts_of, rows_of
from procedures.belt.calibrating.slip import SURE, Parted, WheelSlip, part_at_slips
from procedures.belt.calibrating.spread import (
    LENS,
    PICTURE,
    lens_slopes,
    spread,
    with_camera,
    with_doubt,
    with_lens,
)
from procedures.belt.encoder_alarms import emergency_warnings
from procedures.belt.result import (
    BeltAnswer,
    BeltCalibrationResult,
    BeltHeldOut,
    BeltInputs,
    BeltObservability,
    BeltResiduals,
    BeltUncertainty,
    SightingResidual,
)
from procedures.report.numbers import K95
from procedures.solving import within_limits

KIND = "belt-calibration"
_STANDS_COUNTS = 2.0
_BACK_SHARE = 0.02  # of what was counted; more is no belt that comes to rest
_LONGER = "let more items pass, over a longer way"
_REMEDIES = {
    PICTURE: "mostly because of what the camera gets wrong over its picture, alike for all items, of which "
    "more of them show little: tell depth in finer steps (stereo_subpixel_bits), or take the limit that "
    "your picks allow",
    LENS: "mostly because the camera's calibration has no lens for these pictures: run cone-capture",
    DELAY: "mostly because counts may be late against pictures: keep the belt at an even speed while items "
    "are in view",
}
_MOVED_M = 0.02  # an item that has moved so far lay on a belt that moved
_TURNED_RAD, _OTHER_SHARE = 0.1, 0.05  # from the configured belt, before a person should look


@within_limits
def solve_within_limits(path: Path, config: Mapping[str, Any]) -> BeltCalibrationResult | Result:
    """The result of the data set at ``path``; ``config`` is the job's as plain values."""
    data = read_data_set(path)
    began = time.perf_counter()
    rows = rows_of(data)
    answer = _answer(data, rows, float(config["touch_sigma_m"]))
    inputs = BeltInputs(
        path=str(path),
        source=data["source"],
        device=data["device"],
        sightings=len(rows.t),
        items=len(np.unique(rows.items)),
        counts=len(data["encoder"]),
        solve_seconds=time.perf_counter() - began,
    )
    if isinstance(answer, Refusal):
        return Result(kind=KIND, verdict="fail", reasons=[str(answer)], result=None, inputs=inputs)
    items = len(np.unique(rows.items[answer.used]))
    parted = Parted(answer, rows, [], None)
    if data["source"] == "camera":
        parted = part_at_slips(answer, rows)
        answer, rows = parted.answer, parted.rows
    sure = None if data["source"] == "touch" else spread(answer, rows)
    if sure is not None:
        sure = with_delay(with_doubt(sure, answer, parted.doubt), answer, rows)
        sure = with_camera(sure, answer, *_camera(data, rows, config))
        if (seen := data.get("camera")) is not None:
            camera = parse_part(ItemsCamera, seen, f"{path}: camera")
            if camera.lens is None:
                sure = with_lens(sure, answer, lens_slopes(answer, rows, camera))
        answer = replace(answer, half_scale=sure.half_scale, half_angle=sure.half_angle, cov=sure.cov)
    up, down = _ways(rows)
    sense = -1.0 if up < down else 1.0
    way = sense * answer.direction
    warnings = _warnings(data, sense * answer.m_per_count, way)
    warnings += [_slipped(slip, sense) for slip in parted.slips]
    if min(up, down) > _BACK_SHARE * (up + down):
        back, there = (answer.m_per_count * counts for counts in sorted((up, down)))
        text = (
            f"the belt ran {there:.2f} m and {back:.2f} m back; dir is the longer way: is it the usual one?"
        )
        warnings.append(Warning_(code="belt.both-ways", text=text))
    remedy = _LONGER if sure is None else _REMEDIES.get(sure.by, _LONGER)
    level, rise = (answer.half_angle,) * 2 if sure is None else (sure.half_level, sure.half_rise)
    reasons = _beyond(answer, level, rise, Acceptance(**config["accept"]), remedy)
    if parted.left is not None:
        reasons.append(
            f"slips: {_slip_words(parted.left, sense)}, and that is in m_per_count; repair the wheel"
        )
    verdict: Verdict = "fail" if reasons else "warn" if warnings else "pass"
    return BeltCalibrationResult(
        verdict=verdict,
        reasons=reasons or [w.text for w in warnings],
        warnings=warnings,
        result=_result(answer, sense, way, items),
        uncertainty=BeltUncertainty(
            half_m_per_count=answer.half_scale,
            half_dir_rad=answer.half_angle,
            half_level_rad=level,
            half_rise_rad=rise,
            cov=None if answer.cov is None else answer.cov.tolist(),
            mostly_from=None if sure is None else sure.by,
        ),
        residuals=_residuals(answer, rows),
        heldout=BeltHeldOut(rms_m=answer.heldout),
        observability=BeltObservability(undetermined=_open(data, answer)),
        inputs=inputs,
    )


def _answer(data: Mapping[str, Any], rows: SightingRows, touch_sigma_m: float) -> BeltScale | Refusal:
    if data["source"] == "touch":
        return by_touch(rows, touch_sigma_m)
    encoder = np.array(data["encoder"], dtype=float).reshape(-1, 2)
    counted = max((np.ptp(part[:, 1]) for part in parts_of(encoder, data) if len(part)), default=0.0)
    if counted <= _STANDS_COUNTS:
        span = 0.0 if len(encoder) == 0 else float(np.ptp(encoder[:, 0]))
        if (moved := _moved(rows_of(data, step_counts=0.0))) > _MOVED_M:
            words = f"items moved by {1e3 * moved:.0f} mm while the encoder did not count"
            return Refusal("encoder-stands", f"{words}; look whether its wheel turns with the belt")
        return Refusal("belt-stands", f"the encoder did not count in {span:.0f} s; start the belt")
    return fit_scale(rows.points, rows.counts, rows.items)


def _camera(data: Mapping[str, Any], rows: SightingRows, config: Mapping[str, Any]) -> tuple[float, float]:
    """What the camera's pose may be wrong by (95 %): its turn, rad, and its distance as a share of itself.

    Runs from before these were asked for have neither.
    """
    above = abs(float(data["T_base_camera"][2]) - float(np.mean(rows.points[:, 2])))
    share = float(config.get("distance_95_m", 0.0)) / max(above, 1e-3)
    return float(config.get("camera_turn_95_rad", 0.0)), share


def by_touch(rows: SightingRows, sigma_m: float) -> BeltScale | Refusal:
    """From touches of one mark, each met within ``sigma_m`` (m, per axis); more than two show that."""
    if len(rows.t) < 2:
        return Refusal("too-few-touches", f"{len(rows.t)} of the mark; two are needed")
    if (moved := _moved(rows)) > _MOVED_M and np.ptp(rows.counts) <= _STANDS_COUNTS:
        words = f"the mark moved by {1e3 * moved:.0f} mm while the encoder did not count"
        return Refusal("encoder-stands", f"{words}; look whether its wheel turns with the belt")
    if len(rows.t) > 2:
        answer = fit_scale(rows.points, rows.counts, doubt=False)
    else:
        n = rows.counts
        answer = two_points(rows.points[0], rows.points[1], (round(n[0]), round(n[1])), sigma_m)
    return answer if isinstance(answer, Refusal) else _with_rounding(answer, rows.counts)


def _with_rounding(answer: BeltScale, counts: Array) -> BeltScale:
    """``answer`` from touches at ``counts`` (k,), with the rounding of counts, which is along the belt alone.

    More than two touches leave residuals, which are taken alike along three axes: they show a third of it.
    """
    if answer.half_scale is None or answer.cov is None:
        return answer  # of its noise nothing is known
    unseen = answer.m_per_count**2 / 12.0 * (1.0 if len(counts) == 2 else 2.0 / 3.0)
    variance = unseen / float(np.sum((counts - counts.mean()) ** 2))
    along = answer.direction
    return replace(
        answer,
        half_scale=float(np.hypot(answer.half_scale, K95 * np.sqrt(variance))),
        cov=answer.cov + variance * np.outer(along, along),
    )


def _moved(rows: SightingRows) -> float:
    """The longest way of one item, m."""
    ways = (np.ptp(rows.points[rows.items == i], axis=0) for i in np.unique(rows.items))
    return max((float(np.linalg.norm(way)) for way in ways), default=0.0)


def _ways(rows: SightingRows) -> tuple[float, float]:
    """How far the counter went up with the items, and how far down (counts, both positive).

    A counter that somebody sets while no item is followed across that moves nothing.
    """
    own = (rows.counts[rows.items == i] for i in np.unique(rows.items))  # rows are in the order of time
    steps = np.concatenate([np.diff(counts) for counts in own])
    return float(steps[steps > 0.0].sum()), float(-steps[steps < 0.0].sum())


def _result(answer: BeltScale, sense: float, way: Any, items: int) -> BeltAnswer:
    m, half = sense * answer.m_per_count, answer.half_scale
    return BeltAnswer(
        m_per_count=m,
        dir=way.tolist(),
        m_per_count_95=None if half is None else [m - half, m + half],
        dir_95_rad=answer.half_angle,
        travel_m=answer.travel,
        sightings=int(answer.used.sum()),
        items=items,
    )


def _beyond(
    answer: BeltScale, level: float | None, rise: float | None, limits: Acceptance, remedy: str
) -> list[str]:
    """The limits that the answer misses, each in a sentence; ``level`` and ``rise`` are the halves of its
    direction's intervals (rad), ``remedy`` is what makes the scale surer."""
    reasons = []
    half, heldout = answer.half_scale, answer.heldout
    if half is None or level is None or rise is None:
        return [
            "the intervals are not known, so they cannot be held against max_scale_share, max_dir_rad and "
            "max_rise_rad"
        ]
    if (share := half / answer.m_per_count) > limits.max_scale_share:
        reasons.append(
            f"max_scale_share: m_per_count is known to {100 * share:.3f} % (95 %), the limit is "
            f"{100 * limits.max_scale_share:g} %; {remedy}"
        )
    if level > limits.max_dir_rad:
        reasons.append(
            f"max_dir_rad: dir is known to {1e3 * level:.2f} mrad (95 %) seen from above, the limit is "
            f"{1e3 * limits.max_dir_rad:g} mrad; {_LONGER}"
        )
    if rise > limits.max_rise_rad:
        reasons.append(
            f"max_rise_rad: how dir rises is known to {1e3 * rise:.2f} mrad (95 %), which is as many "
            f"millimetres of height for each metre of travel, the limit is "
            f"{1e3 * limits.max_rise_rad:g} mrad; {_LONGER}"
        )
    if heldout is not None and heldout > limits.max_heldout_m:
        reasons.append(
            f"max_heldout_m: sightings set aside are {1e3 * heldout:.2f} mm RMS beside the motion that the "
            f"others show, the limit is {1e3 * limits.max_heldout_m:g} mm; look for slip of the wheel and "
            "items that roll or slide"
        )
    return reasons


def _warnings(data: Mapping[str, Any], m_per_count: float, way: Any) -> list[Warning_]:
    """Where the answer is so far from the configured belt that one of them was set up wrong."""
    belt, found = data.get("configured"), []
    if belt is not None:
        share = m_per_count / float(belt["m_per_count"]) - 1.0
        if abs(share) > _OTHER_SHARE:
            text = f"m_per_count is {100 * share:+.1f} % from the configured {belt['m_per_count']:g} m"
            found.append(Warning_(code="belt.scale", text=f"{text}; is it the same wheel and encoder?"))
        turned = float(np.arccos(np.clip(way @ np.array(belt["dir"], dtype=float), -1.0, 1.0)))
        if turned > _TURNED_RAD:
            text = f"dir is {np.degrees(turned):.1f} degrees from the configured one"
            found.append(Warning_(code="belt.dir", text=f"{text}; did the belt run its usual way?"))
    if data.get("finished_early"):
        text = f"finished early, {data['finished_early']}"
        found.append(Warning_(code="belt.finished-early", text=text))
    return found + emergency_warnings(data.get("emergencies") or [])


def _slipped(slip: WheelSlip, sense: float) -> Warning_:
    """A slip that is taken out; ``sense`` is that of the counts."""
    text = (
        f"{_slip_words(slip, sense)}; items were taken as others from there on. Look at the wheel, and, "
        "where the belt braked or set out then, measure how late camera and encoder are (latency-calibration)"
    )
    if slip.sigmas < SURE:
        text += ". It may be noise: the interval holds without a slip, too"
    return Warning_(code="belt.slip", text=text)


def _slip_words(slip: WheelSlip, sense: float) -> str:
    where = "ahead of" if sense * slip.ahead_m > 0.0 else "behind"
    return f"the encoder's wheel slipped {1e3 * abs(slip.ahead_m):.1f} mm {where} the belt at {slip.t:.1f} s"


def _residuals(answer: BeltScale, rows: SightingRows) -> BeltResiduals:
    """Each sighting beside the motion of its own item: along the belt, across it in the plane, and up (m)."""
    along = answer.direction
    up = np.array([0.0, 0.0, 1.0])
    across = np.cross(up, along)
    across /= np.linalg.norm(across)
    slope = answer.m_per_count * along
    origin = rows.points - rows.counts[:, None] * slope
    per_sighting = []
    for i in np.unique(rows.items):
        own = rows.items == i
        if not (own & answer.used).any():
            continue
        r = origin - origin[own & answer.used].mean(axis=0)
        for k in np.flatnonzero(own):
            off = [float(r[k] @ axis) for axis in (along, across, np.cross(along, across))]
            t, count = float(rows.t[k]), float(rows.counts[k])
            per_sighting.append(
                SightingResidual(t=t, count=count, item=int(i), used=bool(answer.used[k]), off_m=off)
            )
    used = np.array([row.off_m for row in per_sighting if row.used])
    return BeltResiduals(
        sigma_m=answer.sigma,
        rejected=[int(k) for k in np.flatnonzero(~answer.used)],
        rms_m=float(np.sqrt(np.mean(np.sum(used**2, axis=1)))) if len(used) else None,
        per_sighting=sorted(per_sighting, key=lambda row: row.t),
    )


def _open(data: Mapping[str, Any], answer: BeltScale) -> list[str]:
    """What these data cannot tell, in words."""
    if data["source"] == "touch":
        words = ["errors of the arm's own kinematics and of the tool's point: both are in the answer"]
        if answer.heldout is None:
            words.append("how well the mark was met: with so few touches it is touch_sigma_m, not measured")
        if len(answer.used) == 2:
            words.append("a slip of the encoder's wheel between the two touches; a third would show it")
        return words
    words = [
        "a camera that is turned by more than camera_turn_95_rad, or whose distance from the belt is off by "
        "more than distance_95_m: it turns dir, and stretches m_per_count, as far",
        "a belt that is not level in the base: belt_z_m is its height everywhere, and a "
        "slope of 20 mrad has been 0.2 % of m_per_count",
        "a slip of the encoder's wheel that is no larger than the camera's noise: it is in m_per_count",
    ]
    if data.get("configured") is None:
        words.append(
            "items that move more than half of their spacing between two frames: without a configured belt "
            "one could be taken for the next"
        )
    return words
