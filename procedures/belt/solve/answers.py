"""Answers to the queries of an intercept data set, each from what was known when it was asked."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.belt.classic import T1_S, ClassicTarget, ClassicTimes, classic_target, recomputed
from calibration.belt.estimator import BeltEstimator
from calibration.belt.tracking import BeltTracker, ItemTrack
from calibration.belt.unwrap import Unwrapper, fastest_counts
from cell.formats.intercept import Detection, Query
from cell.poses import Array
from procedures.belt.solve.data import InterceptSet

Done = Callable[[int], None] | None


@dataclass(frozen=True)
class Answer:
    """Positions ``pred`` (h, 2) at ``query.t`` plus each horizon with ``cov`` (h, 2, 2), and the contact.

    None where nothing can be said; ``why`` says why not. ``path`` gives the position (k, 2) at any later
    times, ``track`` is what an answer of ours came from.
    """

    query: Query
    pred: Array | None = None
    cov: Array | None = None
    t_pick: float | None = None
    p_pick: Array | None = None
    cov_pick: Array | None = None
    why: str = ""
    path: Callable[[Array], Array] | None = None
    track: ItemTrack | None = None


@dataclass(frozen=True)
class Solved:
    """Answers in the order of the queries' times, and the tracker that knows everything now (ours only)."""

    answers: list[Answer]
    tracker: BeltTracker


UNSEEN, BLIND = "unseen", "blind"


class InputReplay:
    """Counts and detections as they become known: nothing is, before its stamp."""

    def __init__(self, loaded: InterceptSet) -> None:
        self._loaded = loaded
        self._counts = self._detections = 0

    def until(self, t: float) -> tuple[range, list[Detection]]:
        """Rows of the encoder and detections that arrived since the last call, up to ``t``."""
        counts = max(int(np.searchsorted(self._loaded.t, t, side="right")), self._counts)
        rows, self._counts = range(self._counts, counts), counts
        waiting = self._loaded.detections[self._detections :]
        new = [d for d in waiting if d.t_recv <= t]
        self._detections += len(new)
        return rows, new


def solve_adaptive(loaded: InterceptSet, done: Done = None) -> Solved:
    """Our own estimator and the earliest meeting point."""
    tracker = BeltTracker(BeltEstimator(loaded.encoder), loaded.direction)
    arrivals = InputReplay(loaded)
    answers = []
    for k, query in enumerate(loaded.queries):
        _learn(loaded, tracker, arrivals, query.t)
        answers.append(_answer(loaded, tracker, query))
        if done is not None:
            done(k + 1)
    _learn(loaded, tracker, arrivals, np.inf)
    return Solved(answers, tracker)


def _learn(loaded: InterceptSet, tracker: BeltTracker, arrivals: InputReplay, t: float) -> None:
    rows, detections = arrivals.until(t)
    for k in rows:
        tracker.belt.add(float(loaded.t[k]), loaded.count[k])
    for detection in detections:
        tracker.see(str(detection.id), loaded.sighting(detection), detection.z)


def _answer(loaded: InterceptSet, tracker: BeltTracker, query: Query) -> Answer:
    track = tracker.track(str(query.id))
    if track is None:
        return Answer(query, why=BLIND if tracker.seen(str(query.id)) else UNSEEN)
    at = query.t + np.array(query.horizons)
    shared = camera_cov_of(loaded, tracker, str(query.id))
    shared = np.zeros((2, 2)) if shared is None else shared
    meeting = track.meet(query.t, loaded.arm, loaded.zone, loaded.dwell)
    return Answer(
        query=query,
        pred=track.xy(at),
        cov=np.array([track.cov(float(t)) + shared for t in at]).reshape(-1, 2, 2),
        t_pick=None if meeting is None else meeting.t,
        p_pick=None if meeting is None else meeting.xy,
        cov_pick=None if meeting is None else track.cov(meeting.t) + shared,
        path=track.xy,
        track=track,
    )


def camera_cov_of(loaded: InterceptSet, tracker: BeltTracker, item: str) -> Array | None:
    """(2, 2) m^2 of where ``item`` lies: what the camera's pose and lens leave open; None where not known."""
    return loaded.camera_cov(np.array([[*seen.xy, z] for seen, z in tracker.sightings(item)]))


def solve_classic(loaded: InterceptSet, done: Done = None) -> Solved:
    """The classic method; the tracker is ours, for the checks that both methods are held to."""
    tracker = BeltTracker(BeltEstimator(loaded.encoder), loaded.direction)
    arrivals = InputReplay(loaded)
    _learn(loaded, tracker, arrivals, np.inf)
    t, n = _unwrapped(loaded)
    answers = []
    for k, query in enumerate(loaded.queries):
        answers.append(_classic_answer(loaded, t, n, query))
        if done is not None:
            done(k + 1)
    return Solved(answers, tracker)


def _unwrapped(loaded: InterceptSet) -> tuple[Array, Array]:
    unwrapper = Unwrapper(loaded.encoder.modulus, fastest_counts(loaded.encoder.m_per_count))
    n = [unwrapper.add(float(t), c) for t, c in zip(loaded.t, loaded.count, strict=True)]
    rows = [k for k, v in enumerate(n) if v is not None]
    return loaded.t[rows], np.array([n[k] for k in rows], dtype=float)


def classic_times(loaded: InterceptSet) -> ClassicTimes:
    """T1 and t2 of the data set, else the classic T1 and the arm's own time for the descent."""
    given = loaded.data.classic
    t1 = None if given is None else given.T1_s
    t2 = None if given is None else given.t2_s
    return ClassicTimes(T1_S if t1 is None else t1, loaded.arm.descent_s if t2 is None else t2)


def _classic_answer(loaded: InterceptSet, t: Array, n: Array, query: Query) -> Answer:
    seen = [d for d in loaded.detections if d.t_recv <= query.t and str(d.id) == str(query.id)]
    if not seen:
        return Answer(query, why=UNSEEN)
    # Computed every 100 ms; an item that came in since is computed when it comes.
    tick = max(recomputed(float(t[0]), query.t), seen[0].t_recv) if len(t) else query.t
    known = [d for d in seen if d.t_recv <= tick]
    sighting = loaded.sighting(known[-1])
    rows = slice(0, int(np.searchsorted(t, tick, side="right")))
    target = classic_target(
        t[rows],
        n[rows],
        sighting.t,
        np.array([*known[-1].xy, known[-1].z]),
        loaded.direction,
        loaded.encoder.m_per_count,
    )
    return Answer(query, why=BLIND) if target is None else _of_target(loaded, query, target)


def _of_target(loaded: InterceptSet, query: Query, target: ClassicTarget) -> Answer:
    meeting = target.meet(loaded.arm, classic_times(loaded), loaded.zone, loaded.dwell)
    return Answer(
        query=query,
        pred=target.at(query.t + np.array(query.horizons)),
        path=target.at,
        t_pick=None if meeting is None else meeting[0],
        p_pick=None if meeting is None else meeting[1],
    )
