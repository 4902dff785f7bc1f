"""Inputs whose polls are now and then late, as those of a module on a busy network."""

import numpy as np

from cell.clock import Clock
from cell.devices import InputsState
from cell.samples import Sample
from fakes.object import ObjectInputs
from fakes.object.inputs import ObjectInputsConfig

SHARE, LATE_S = 0.1, 0.04
_DRAWN_FOR = 0x1A7E  # keeps these draws apart from others of the same seed


class LateInputs(ObjectInputs):
    """One poll of ten comes up to 40 ms late, and those that would have come meanwhile are not made."""

    def __init__(self, name: str, config: ObjectInputsConfig, clock: Clock) -> None:
        super().__init__(name, config, clock)
        self._rng = np.random.default_rng([self.world.config.seed, _DRAWN_FOR])
        self._silent_until = -np.inf
        self._push = self.inputs.push
        self.inputs.push = self._now_and_then  # type: ignore[method-assign]

    def _now_and_then(self, sample: Sample[InputsState]) -> None:
        if sample.t < self._silent_until:
            return
        if self._rng.random() < SHARE:
            self._silent_until = sample.t + LATE_S * self._rng.random()
            return
        self._push(sample)
