"""The classic cone method's figures of a capture: unweighted estimates in the order on the cone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.neighbours import (
    WIDEST_M,
    Deviation,
    NeighbourEstimates,
    across,
    mean_of_means,
    neighbour_estimates,
    within,
)
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import weak_views
from cell.errors import error
from cell.formats.capture import Observation
from cell.poses import Array, to_pose6
from procedures.hand_eye.result_spread import NeighbourBase, NeighbourSpread, PlainSpread
from procedures.hand_eye.solve.capture import CaptureSet

TOO_WIDE = (
    f"the estimates lie more than {WIDEST_M:g} m apart: neighbouring poses turn too little, or about one axis"
)
CLASSIC, CLASSIC_LEAST_SQUARES = "classic", "classic-least-squares"


@dataclass(frozen=True)
class Neighbours:
    """The estimates of all placements; ``bases`` says at which base (-1: not told) each stands."""

    found: list[NeighbourEstimates]
    bases: NDArray[np.int64]
    planned: bool  # in the order on the cone, else in that of the observations

    def pose(self, method: str) -> Array:
        """X (4, 4) by ``method``; ``ARGUMENT_INVALID`` where the placements determine none."""
        if method == CLASSIC and self._too_wide():
            raise error("ARGUMENT_INVALID", f"method {method!r}: {TOO_WIDE}; leave --method out")
        X = mean_of_means(self.found, method == CLASSIC_LEAST_SQUARES)
        if X is None:
            raise error(
                "ARGUMENT_INVALID",
                f"method {method!r} needs three neighbouring poses in a placement that turn about two axes; "
                "leave --method out",
            )
        return X

    def _too_wide(self) -> bool:
        return any(of is not None and of.too_wide for of in (within(self.found), across(self.found)))

    def spread(self) -> NeighbourSpread:
        """``neighbour_spread`` of the result."""
        bases = sorted({int(b) for b in self.bases if b >= 0})
        wide = self._too_wide()
        X = None if wide else mean_of_means(self.found)
        return NeighbourSpread(
            within=_plain(within(self.found)),
            across=_plain(across(self.found)),
            across_least_squares=_plain(across(self.found, least_squares=True)),
            by_base={
                str(b): NeighbourBase(within=_plain(within(part)), across=_plain(across(part)))
                for b in bases
                for part in [[p for p in self.found if self.bases[p.group] == b]]
            },
            pose=None if X is None else [float(v) for v in to_pose6(se3.transforms(X))],
            triples=sum(len(p.X) for p in self.found),
            skipped=sum(p.skipped for p in self.found),
            order="planned" if self.planned else "observations",
            not_determined=TOO_WIDE if wide else None,
        )


def neighbours_of(loaded: CaptureSet, rows: NDArray[np.int64], problem: Problem) -> Neighbours:
    """Of the problem whose observations are ``rows`` of ``loaded``, those with too poor an image left out."""
    weak = weak_views(problem)
    kept = np.array([i for i in range(problem.n) if i not in weak], dtype=np.int64)
    told = [loaded.capture.observations[int(rows[i])] for i in kept]
    places = [_planned(o) for o in told]
    planned = all(place is not None for place in places)
    place = np.array([p if p is not None else k for k, p in enumerate(places)], dtype=np.int64)
    if not planned:
        place = np.arange(len(kept))
    part = problem.take(kept)
    return Neighbours(neighbour_estimates(part, place), _bases(told, part), planned)


def _planned(observation: Observation) -> int | None:
    """Its place on the cone; data sets of before kept it among the notes."""
    if observation.planned is not None:
        return observation.planned
    notes = observation.notes
    place = notes.get("planned") if isinstance(notes, dict) else None
    return place if isinstance(place, int) else None


def _bases(told: Sequence[Observation], problem: Problem) -> NDArray[np.int64]:
    bases = np.full(problem.groups, -1, dtype=np.int64)
    for observation, group in zip(told, problem.group, strict=True):
        if observation.base is not None:
            bases[int(group)] = observation.base
    return bases


def _plain(found: Deviation | None) -> PlainSpread | None:
    if found is None or found.too_wide:
        return None
    return PlainSpread(t=found.t.tolist(), t_norm=float(np.linalg.norm(found.t)), r=found.r)
