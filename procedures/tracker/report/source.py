"""What the sections of a kinematic calibration's report ask for: figures, samples, the arm, the tracker."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calibration.identification.joint_errors import START_RAD, extended
from calibration.identification.model import Model, make_model
from calibration.identification.workspace import places, worst_forecast
from calibration.kinematics.families import arm_spec
from cell.errors import CellError
from cell.formats.robot import parse_robot
from cell.poses import Array
from procedures.report.numbers import dig, matrix4, number
from procedures.report.source import Source
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
class Measured:
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
class KincalSource(Source):
    """A result of kind ``kincal``; its data set is ``cellward.kincal/1``, a table, or MATLAB columns."""

    @property
    def tracker_3d(self) -> float | None:
        """sqrt(3) times the sigma of a reading along one axis, at the middle range, m."""
        return number(dig(self.result, "uncertainty", "tracker", "sigma_3d")) or number(
            dig(self.result, "heldout", "tracker_3d")
        )

    @property
    def whose_noise(self) -> str:
        """Whose sigma that is: where the tracker's was not given, it is all that the residuals hold."""
        return "scatter" if dig(self.answer, "noise", "given") is False else "tracker"

    @property
    def freedom(self) -> float:
        """Degrees of freedom that the covariance was sized with; infinite where the noise was given."""
        return number(dig(self.result, "uncertainty", "degrees_of_freedom")) or np.inf

    @property
    def per_sample(self) -> list[Mapping[str, Any]]:
        rows = dig(self.result, "residuals", "per_sample")
        return [r for r in rows if isinstance(r, Mapping)] if isinstance(rows, list) else []

    @property
    def rejected(self) -> dict[int, str]:
        """Number and reason of each sample that was not used."""
        listed = dig(self.answer, "rejected")
        if self.answer is None:
            listed = dig(self.result, "observability", "unusable")
        rows = listed if isinstance(listed, list) else []
        return {int(dig(r, "index")): str(dig(r, "reason")) for r in rows if dig(r, "index") is not None}

    @property
    def sampling(self) -> Mapping[str, Any] | None:
        """What a run notes of itself; None for a data set from elsewhere."""
        found = dig(self.result, "inputs", "sampling")
        return found if isinstance(found, Mapping) else None

    @property
    def T_base_tracker(self) -> Array | None:
        """(4, 4): where the tracker stands in the base."""
        T = matrix4(dig(self.answer, "T_tracker_base"))
        return None if T is None else np.asarray(np.linalg.inv(T))

    @cached_property
    def measured(self) -> Measured | None:
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
        return Measured(index, np.array(Q, dtype=float), np.array(p, dtype=float), target)

    @cached_property
    def model(self) -> Model | None:
        """The calibrated arm with its targets, its values as ``nominal``; None when the result has none."""
        document, targets = dig(self.answer, "robot"), dig(self.result, "inputs", "targets")
        if not isinstance(document, Mapping) or not isinstance(targets, list):
            return None
        names = dig(self.result, "uncertainty", "names") or ()
        errors = {k: sd for k, sd in START_RAD.items() if any(str(n).startswith(k) for n in names)}
        try:
            model = make_model(arm_spec(parse_robot(document, "result.robot")), [str(t) for t in targets])
            return extended(model, errors) if errors else model
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
        found = dig(self.result, "uncertainty", "cov")
        names = dig(self.result, "uncertainty", "names")
        if self.model is None or not isinstance(found, list) or not isinstance(names, list):
            return None
        own = list(self.model.names)
        if sorted(names[:-6]) != sorted(own) or len(found) != len(names):
            return None
        order = [*(names.index(name) for name in own), *range(len(own), len(own) + 6)]
        return np.array(found, dtype=float)[np.ix_(order, order)]

    def _listed(self) -> Forecast | None:
        rows = dig(self.result, "uncertainty", "predicted_95", "workspace", "places")
        if not isinstance(rows, list) or not rows:
            return None
        p = np.array([dig(r, "p_base") for r in rows], dtype=float)
        error = np.array([dig(r, "error_95") for r in rows], dtype=float)
        return Forecast(p, error)
