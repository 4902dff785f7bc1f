"""The result of an intercept data set: answers, how sure they are, and what later data say of them."""

from collections.abc import Iterator, Sequence

import numpy as np

from calibration.belt.scale import BeltScale, fit_scale
from calibration.belt.tracking import ItemTrack
from cell.formats.intercept import Detection, Query
from cell.formats.result import Result, Warning_
from cell.poses import Array
from procedures.belt.result import (
    BeltFromSightings,
    ForecastHeldOut,
    ForecastResiduals,
    InterceptAnswer,
    InterceptInputs,
    InterceptObservability,
    InterceptResult,
    InterceptUncertainty,
    QueryAnswer,
    QueryUncertainty,
    SightingCheck,
    TravelCheck,
)
from procedures.belt.solve.answers import BLIND, UNSEEN, Answer, Solved, camera_cov_of
from procedures.belt.solve.data import InterceptSet
from procedures.report.numbers import K95

KIND = "intercept"
_SURE = 4.0  # standard deviations by which sightings contradict the belt's scale or direction
_FEWEST = 8
_LATENCY_OFF = 2e-3  # s


def refusal(loaded: InterceptSet, method: str) -> Result | None:
    """Why no query at all can be answered; None when some can."""
    name, words = "", ""
    if len(loaded.t) < 2:
        name, words = "too-few-counts", f"the encoder gave {len(loaded.t)} counts; speed is not observable"
    elif float(np.ptp(loaded.t)) <= 0.0:
        name, words = "no-time", "all counts bear the same stamp; speed is not observable"
    elif not loaded.detections:
        name, words = "no-detections", "no item was seen; where items lie on the belt is not observable"
    if not name:
        return None
    return Result(
        kind=KIND,
        verdict="fail",
        reasons=[f"{name}: {words}"],
        warnings=Warning_.each(loaded.warnings),
        result=None,
        observability={"refused": name, "unobservable": [words]},
        inputs=_inputs(loaded, method),
    )


def fill_result(loaded: InterceptSet, solved: Solved, method: str, seconds: float) -> InterceptResult:
    """The whole result: ``warn`` when anything is to be warned of, ``fail`` when no query is answered."""
    scale = belt_from_sightings(loaded, solved)
    known = [solved.tracker.track(item) for item in solved.tracker.items]
    tracks = [track for track in known if track is not None]
    warnings = [
        *loaded.warnings,
        *_encoder_warnings(solved),
        *_latency_warnings(loaded),
        *_scale_warnings(loaded, scale),
        *_query_warnings(solved),
        *_stray_warnings(tracks),
    ]
    in_file = sorted(range(len(solved.answers)), key=lambda k: loaded.order[k])
    answers = [solved.answers[k] for k in in_file]
    reasons = [text for _, text in warnings]
    blind = bool(answers) and all(a.pred is None for a in answers)
    if blind:
        reasons.insert(
            0,
            "no-answers: nothing was known when the queries were asked; are all stamps seconds of one clock?",
        )
    return InterceptResult(
        verdict="fail" if blind else "warn" if warnings else "pass",
        reasons=reasons,
        warnings=Warning_.each(warnings),
        result=InterceptAnswer(answers=[_as_answer(a) for a in answers], method=method),
        uncertainty=_uncertainty(answers, _camera_95_m(loaded, solved)),
        residuals=_residuals(solved, tracks, scale),
        heldout=_held_out(loaded, solved),
        observability=_observability(loaded, scale),
        inputs=_inputs(loaded, method).changed(solve_seconds=seconds),
    )


def _inputs(loaded: InterceptSet, method: str) -> InterceptInputs:
    limits = loaded.arm.limits
    return InterceptInputs(
        method=method,
        counts=len(loaded.t),
        detections=len(loaded.detections),
        queries=len(loaded.queries),
        m_per_count=loaded.encoder.m_per_count,
        dir=loaded.direction.tolist(),
        modulus=loaded.encoder.modulus,
        period_s=loaded.encoder.period,
        latency_mean_s=loaded.data.latency_mean,
        limits={"v": limits.v, "a": limits.a, "j": limits.j},
        t2_s=loaded.arm.descent_s,
        dwell_s=loaded.dwell,
    )


def _as_answer(a: Answer) -> QueryAnswer:
    nothing: list[list[float | None]] = [[None, None]] * len(a.query.horizons)
    return QueryAnswer(
        id=a.query.id,
        t=a.query.t,
        pred=nothing if a.pred is None else a.pred.tolist(),
        t_pick=a.t_pick,
        p_pick=None if a.p_pick is None else a.p_pick.tolist(),
    )


def _camera_95_m(loaded: InterceptSet, solved: Solved) -> float | None:
    covs = [camera_cov_of(loaded, solved.tracker, item) for item in solved.tracker.items]
    worst = [float(np.linalg.eigvalsh(cov)[-1]) for cov in covs if cov is not None]
    return K95 * float(np.sqrt(np.mean(worst))) if worst else None


def _uncertainty(answers: list[Answer], camera_95_m: float | None) -> InterceptUncertainty:
    rows = [
        QueryUncertainty(
            id=a.query.id,
            t=a.query.t,
            cov=None if a.cov is None else a.cov.tolist(),
            cov_pick=None if a.cov_pick is None else a.cov_pick.tolist(),
            motion=None if a.track is None else a.track.forecast.motion.name,
        )
        for a in answers
    ]
    meaning = (
        "covariance of x, y (m^2) per horizon and of the contact point: camera, exposure, counts, and how "
        "far the last forecasts over the same time were off, and where known what the camera's pose and "
        "lens leave open; a stop that has not begun is in it only as far as the belt stopped before"
    )
    if all(a.cov is None for a in answers):
        meaning = "the classic method gives none" if any(a.pred is not None for a in answers) else "no answer"
    return InterceptUncertainty(answers=rows, camera_95_m=camera_95_m, meaning=meaning)


def _residuals(solved: Solved, tracks: Sequence[ItemTrack], scale: BeltScale | None) -> ForecastResiduals:
    levels = solved.tracker.levels()
    forecast = solved.tracker.belt.forecast()
    share = None if forecast is None else forecast.motion.timed.share
    often = [t.residuals()[t.place.used] for t in tracks if len(t.sightings) > 1]
    off = np.concatenate([np.zeros((0, 2)), *often])
    return ForecastResiduals(
        counts_sigma=None if forecast is None else forecast.motion.judge.sigma,
        stamp_share=share,
        camera_sigma_m=levels.camera,
        latency_sigma_s=levels.latency,
        along_rms_m=_rms(off[:, 0].tolist()),
        across_rms_m=_rms(off[:, 1].tolist()),
        belt_from_sightings=None if scale is None else _belt(scale),
        meaning="sightings of one item about its mean on the belt; residuals are not accuracy",
    )


def _belt(found: BeltScale) -> BeltFromSightings:
    m, half = found.m_per_count, found.half_scale
    return BeltFromSightings(
        m_per_count=m,
        dir=found.direction.tolist(),
        m_per_count_95=None if half is None else [m - half, m + half],
        dir_95_rad=found.half_angle,
        cov=None if found.cov is None else found.cov.tolist(),
        sigma_m=found.sigma,
        heldout_rms_m=found.heldout,
        travel_m=found.travel,
        rejected=[int(i) for i in np.flatnonzero(~found.used)],
    )


def _rms(values: list[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def _held_out(loaded: InterceptSet, solved: Solved) -> ForecastHeldOut:
    """Every answer judged by what came after its query: counts, and sightings of the same item."""
    belt = solved.tracker.belt
    travel: dict[float, list[float]] = {}
    for a in solved.answers:
        for h in a.query.horizons if a.track is not None else ():
            seen = belt.travel_at(a.query.t + h)
            if seen is not None and a.track is not None:
                predicted = a.track.forecast.travels_at(a.query.t + h)
                travel.setdefault(float(h), []).append(predicted - seen)
    sightings = [float(np.linalg.norm(d)) for d in _later_sightings(loaded, solved)]
    return ForecastHeldOut(
        travel=[TravelCheck(horizon=h, rms_m=_rms(v), count=len(v)) for h, v in sorted(travel.items())],
        later_sightings=SightingCheck(rms_m=_rms(sightings), count=len(sightings)),
        meaning="forecasts against counts and sightings from after the query, which they did not use",
    )


def _later_sightings(loaded: InterceptSet, solved: Solved) -> Iterator[Array]:
    of_item: dict[str, list[Detection]] = {}
    for d in loaded.detections:
        of_item.setdefault(str(d.id), []).append(d)
    for a in solved.answers:
        for d in of_item.get(str(a.query.id), ()) if a.path is not None else ():
            later = d.t_exp is not None and min(d.t_exp, d.t_recv) > a.query.t
            if later and a.path is not None:
                yield a.path(np.array([d.t_exp]))[0] - np.array(d.xy)


def belt_from_sightings(loaded: InterceptSet, solved: Solved) -> BeltScale | None:
    """Scale and direction of the belt as the sightings of items seen several times show them.

    Only sightings whose exposure is known; counts are taken from the smoothed travel.
    """
    points, counts, items = [], [], []
    for k, item in enumerate(solved.tracker.items):
        for sighting, z in solved.tracker.sightings(item):
            travel = solved.tracker.belt.travel_at(sighting.t) if sighting.sure else None
            if travel is not None:
                points.append([*sighting.xy, z])
                counts.append(travel / loaded.encoder.m_per_count)
                items.append(k)
    if len(points) < _FEWEST:
        return None
    found = fit_scale(np.array(points)[:, :2], counts, items)
    return found if isinstance(found, BeltScale) else None


def _observability(loaded: InterceptSet, scale: BeltScale | None) -> InterceptObservability:
    words = [
        "a constant error of all exposure times shifts every item along the belt and cannot be seen here",
        "a stop or start that has not begun cannot be predicted",
    ]
    if scale is None:
        words.append("m_per_count and dir are taken as given: no item was seen often enough to check them")
    return InterceptObservability(unobservable=words)


def _encoder_warnings(solved: Solved) -> list[tuple[str, str]]:
    belt, out = solved.tracker.belt, []
    if belt.unwrapper.resets:
        at = ", ".join(f"{t:.3f}" for t in belt.unwrapper.resets[:3])
        text = f"the count jumped {len(belt.unwrapper.resets)} times (at {at} s) by more than a belt can move"
        out.append(("encoder.reset", f"{text}; the travel was carried on with the speed from before"))
    if belt.unwrapper.misread:
        text = f"{belt.unwrapper.misread} counts do not belong to the others and were left out"
        out.append(("encoder.misread", text))
    return out


def _latency_warnings(loaded: InterceptSet) -> list[tuple[str, str]]:
    late = np.array([d.t_recv - d.t_exp for d in loaded.detections if d.t_exp is not None])
    unknown = sum(d.t_exp is None for d in loaded.detections)
    mean = loaded.data.latency_mean
    if mean is None or not unknown or len(late) < _FEWEST:
        return []
    off, doubt = float(np.mean(late)) - mean, float(np.std(late)) / np.sqrt(len(late))
    if abs(off) < _LATENCY_OFF + _SURE * doubt:
        return []
    text = f"detections with a known exposure arrive {1e3 * (mean + off):.1f} ms after it, latency_mean says"
    return [("detections.latency", f"{text} {1e3 * mean:.1f} ms; it was used for {unknown} without exposure")]


def _scale_warnings(loaded: InterceptSet, scale: BeltScale | None) -> list[tuple[str, str]]:
    """Sightings that contradict the belt's given scale or direction."""
    if scale is None or scale.cov is None:
        return []
    given = loaded.encoder.m_per_count * loaded.direction[:2]
    found = scale.m_per_count * scale.direction
    sigma = float(np.sqrt(scale.cov[0, 0]))
    along = given / np.linalg.norm(given)
    off, aside = (found - given) @ along, (found - given) @ np.array([-along[1], along[0]])
    size = float(np.linalg.norm(given))
    out = []
    if off < -size:
        return [("belt.direction", "the items move against belt.dir; turn it round, or m_per_count's sign")]
    if abs(off) > _SURE * sigma + 1e-4 * size:
        text = f"the sightings show {1e2 * off / size:+.2f} % more travel per count than m_per_count"
        out.append(("belt.scale", f"{text}; run belt-calibration"))
    if abs(aside) > _SURE * sigma + 2e-4 * size:
        text = f"the items move {np.degrees(aside / size):+.2f} deg aside of belt.dir"
        out.append(("belt.direction", f"{text}; run belt-calibration"))
    return out


def _query_warnings(solved: Solved) -> list[tuple[str, str]]:
    out = []
    for why, code, words in (
        (UNSEEN, "queries.unseen", "ask for items of which no detection had arrived yet"),
        (BLIND, "queries.blind", "ask before two counts had arrived"),
    ):
        asked: list[Query] = [a.query for a in solved.answers if a.why == why]
        if asked:
            first = f"first: {asked[0].id!r} at {asked[0].t:.3f} s"
            out.append((code, f"{len(asked)} queries {words} ({first}); their answer is null"))
    return out


def _stray_warnings(tracks: Sequence[ItemTrack]) -> list[tuple[str, str]]:
    stray = sum(int((~track.place.used).sum()) for track in tracks)
    if not stray:
        return []
    text = f"{stray} detections lie apart from the others of the same item and were left out"
    return [("detections.stray", text)]
