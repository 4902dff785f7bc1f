"""What the sections of a kinematic calibration's report ask for: figures, samples, the arm, the tracker."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.identification.model import Model
from calibration.identification.workspace import places, worst_forecast
from cell.errors import CellError
from cell.poses import Array
from procedures.report.numbers import matrix4
from procedures.report.source import Source
from procedures.tracker.calibrated_model import calibrated_model, covariance_of, freedom_of
from procedures.tracker.result import KincalResult, SampleResidual, Sampling
from procedures.tracker.solve.data import read_kincal

_MAP_PLACES = 8000
_ANGLES = ("theta", "alpha", "beta")
_MOTOR_OFFSETS = ("t1", "t2", "t3", "t5")


def kind_of(name: str) -> str:
    """``length``, ``angle`` or ``ratio`` of a parameter, by its name in the result."""
    if name.endswith((".x", ".y", ".z")):  # the place of a target, whatever it is called
        return "length"
    if name.startswith(_ANGLES) or name in _MOTOR_OFFSETS:
        return "angle"
    return "ratio" if name.startswith("k") else "length"


@dataclass(frozen=True, eq=False)
class MeasuredSamples:
    """Usable samples of the data set: their own numbers, joints ``Q`` (n, j), reflectors in the tracker frame
    (n, 3) m, and the names of the reflectors."""

    index: list[int]
    Q: Array
    p_tracker: Array
    target: list[str]


@dataclass(frozen=True, eq=False)
class Forecast:
    """Places (n, 3) m in the base, and the length (n,) m that 95 % of prediction errors stay below there."""

    p: Array
    error95: Array


@dataclass
class KincalSource(Source[KincalResult]):
    """A result of kind ``kincal``; its data set is ``cellward.kincal/1``, a table, or MATLAB columns."""

    @property
    def tracker_3d(self) -> float | None:
        """sqrt(3) times the sigma of a reading along one axis, at the middle range, m."""
        if self.found is None:
            return None
        tracker = self.found.uncertainty.tracker
        return self.found.heldout.tracker_3d if tracker is None else tracker.sigma_3d

    @property
    def whose_noise(self) -> str:
        """Whose sigma that is: where the tracker's was not given, it is all that the residuals hold."""
        return "tracker" if self.found is None or self.found.result.noise.given else "scatter"

    @property
    def freedom(self) -> float:
        """Degrees of freedom that the covariance was sized with; infinite where the noise was given."""
        return np.inf if self.found is None else freedom_of(self.found)

    @property
    def per_sample(self) -> list[SampleResidual]:
        return [] if self.found is None else self.found.residuals.per_sample

    @property
    def rejected(self) -> dict[int, str]:
        """Number and reason of each sample that was not used."""
        if self.found is None:
            return {int(r["index"]): str(r["reason"]) for r in self.known("unusable") or []}
        return {r.index: r.reason for r in self.found.result.rejected}

    @property
    def sampling(self) -> Sampling | None:
        """What a run notes of itself; None for a data set from elsewhere."""
        if self.found is not None:
            return self.found.inputs.sampling
        noted = getattr(self.result.made_from(), "sampling", None)
        return None if noted is None else Sampling.model_validate(noted)

    @property
    def T_base_tracker(self) -> Array | None:
        """(4, 4): where the tracker stands in the base."""
        T = None if self.found is None else matrix4(self.found.result.T_tracker_base)
        return None if T is None else np.asarray(np.linalg.inv(T))

    @cached_property
    def measured(self) -> MeasuredSamples | None:
        """The samples; None, with a line in ``missing``, when the data set cannot be read."""
        if self.data is None:
            self.missing.append("No data set is at hand, so the poses cannot be drawn.")
            return None
        try:
            _, data = read_kincal(self.data)
        except CellError as exc:
            self.missing.append(f"The data set cannot be read: {exc}")
            return None
        rows = [
            (k if s.index is None else s.index, s.q, s.p_tracker, s.target or "")
            for k, s in enumerate(data.samples)
            if s.p_tracker is not None and None not in s.p_tracker
        ]
        if not rows:
            return None
        index, Q, p, target = (list(column) for column in zip(*rows, strict=True))
        return MeasuredSamples(index, np.array(Q, dtype=float), np.array(p, dtype=float), target)

    @cached_property
    def model(self) -> Model | None:
        """The calibrated arm with its targets, its values as ``nominal``; None without an answer."""
        if self.found is None:
            return None
        try:
            return calibrated_model(self.found)
        except CellError as exc:
            self.missing.append(f"The calibrated arm cannot be drawn: {exc}")
            return None

    @property
    def frames(self) -> Array | None:
        """(n, m + 1, 3) m: the origins of the arm's links in the base, at every usable sample."""
        if self.measured is None or self.model is None:
            return None
        if self.measured.Q.shape[1] != self.model.arm.joints:
            return None
        own = len(self.model.arm.names)
        chain = self.model.arm.chain(self.model.nominal[:own])
        return np.asarray(chain.frames(self.measured.Q)[:, :, :3, 3])

    @cached_property
    def forecast(self) -> Forecast | None:
        """Predicted errors over the sampled joint ranges: many where the covariance can be carried there,
        else the places that the result lists."""
        dense = None if self.measured is None else self.forecast_at(places(self.measured.Q, _MAP_PLACES))
        return dense or self._listed()

    def forecast_at(self, Q: Array) -> Forecast | None:
        """Predicted errors at joints ``Q`` (n, j), of the reflector that is known worst; None without a
        covariance."""
        cov, model = self._covariance(), self.model
        if cov is None or model is None or Q.shape[1] != model.arm.joints:
            return None
        found = worst_forecast(model, model.nominal, cov, self.freedom, Q)
        return Forecast(found.p, found.error95)

    def _covariance(self) -> Array | None:
        """(p + 6, p + 6) in the order of :attr:`model`; None when the result has other parameters."""
        return None if self.found is None or self.model is None else covariance_of(self.found, self.model)

    def _listed(self) -> Forecast | None:
        predicted = None if self.found is None else self.found.uncertainty.predicted_95
        if predicted is None or not predicted.workspace.places:
            return None
        rows = predicted.workspace.places
        return Forecast(np.array([r.p_base for r in rows]), np.array([r.error_95 for r in rows]))
