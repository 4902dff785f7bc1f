"""Where the tracker stands, as far as a sampling knows by now, and so where each reflector should be seen."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.registration import Registration, robust_register
from cell.errors import present
from cell.poses import Array
from cell.run_values import RunValues
from procedures.laser_tracker.locating import apart, pose6_of, registration_of
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import Space, make_space

ELSEWHERE_M, ELSEWHERE_RAD = 0.03, 0.01  # a plan holds where the tracker stands no further off than this


class TrackerPose:
    """Begins with what the config says, if anything; poses that are measured make it better."""

    def __init__(self, config: TrackerSamplingConfig, values: RunValues, noise: Mapping[str, float]) -> None:
        self._config, self._values, self._noise = config, values, noise
        self._names = list(config.reflectors)
        self.space: Space = make_space(values, config, noise, None)
        self.registration: Registration | None = None
        if config.T_base_tracker_nominal is not None:
            self.registration = registration_of(config.T_base_tracker_nominal)

    @property
    def T_base_tracker(self) -> list[float] | None:
        """As pose6; None while it is unknown."""
        return None if self.registration is None else pose6_of(self.registration)

    @property
    def located(self) -> Registration:
        """Where it stands, once it was measured or the config says it."""
        return present(self.registration, "place of the tracker")

    def found_at(self, T_base_tracker: list[float]) -> None:
        """It was measured: from now on what can be seen is known as well."""
        self.registration = registration_of(T_base_tracker)
        self.space = make_space(self._values, self._config, self._noise, T_base_tracker)

    def refine(self, samples: Sequence[Mapping[str, Any]]) -> None:
        """All finished poses tell of the tracker's place; more of them tell it better."""
        f = np.array([self.nominal_point(np.array(s["q"]), s["target"]) for s in samples]).T
        if np.linalg.matrix_rank(f - f.mean(axis=1, keepdims=True), tol=0.1) == 3:
            p = np.array([s["p_tracker"] for s in samples]).T
            self.registration = robust_register(p, f, np.ones(len(samples)))

    def elsewhere(self, T_planned: Sequence[float]) -> tuple[float, float] | None:
        """How far (m, rad) it is from where a plan assumed it; None while the plan still holds."""
        shift, turn = apart(T_planned, pose6_of(self.located))
        return (shift, turn) if shift > ELSEWHERE_M or turn > ELSEWHERE_RAD else None

    def nominal_point(self, q: Array, reflector: str) -> Array:
        """(3,): where the nominal arm has a reflector, in the base."""
        out: Array = self.drawn_many(np.asarray(q)[None], reflector)[0]
        return out

    def drawn_many(self, Q: Array, reflector: str) -> Array:
        """(n, 3): the same for joints (n, j)."""
        target = np.full(len(Q), self._names.index(reflector), dtype=np.int64)
        return self.space.points(Q, target)

    def expected(self, q: Array, reflector: str) -> Array | None:
        """(3,): where the tracker should see it; None while it is unknown."""
        if self.registration is None:
            return None
        out: Array = self.registration.to_tracker(self.nominal_point(q, reflector)[:, None])[:, 0]
        return out

    def monuments_hidden(self, q: Array) -> NDArray[np.bool_]:
        """(n,): which monuments the arm's links hide from the tracker when it stands at ``q`` (j,)."""
        p = np.array([m.point for m in self._config.monuments.values()]).reshape(-1, 3)
        view, ends = self.space.view, self.space.link_ends(q[None])
        if view is None or ends is None:
            return np.zeros(len(p), dtype=bool)
        return view.hidden(p, np.repeat(ends, len(p), axis=0))
