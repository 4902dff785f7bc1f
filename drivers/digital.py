"""What all digital inputs have in common: how one is configured, and the watch for inputs that are stuck."""

import logging
from collections.abc import Mapping

from pydantic import Field

from cell.formats.reading import Strict

log = logging.getLogger("cellward.devices")


class InputConfig(Strict):
    """One digital input."""

    address: int = Field(ge=0, le=65535, description="Number of the input, counted from 0")
    invert: bool = Field(default=False, description="The logical level is the opposite of the electrical one")
    stuck_on_s: float | None = Field(
        default=None, gt=0.0, le=1e6, description="On for longer means that it is stuck; absent: never"
    )
    stuck_off_s: float | None = Field(
        default=None, gt=0.0, le=1e6, description="Off for longer means that it is stuck; absent: never"
    )


class StuckWatch:
    """Which inputs have not changed for longer than they may; one log line when that begins and ends."""

    def __init__(self, device: str, inputs: Mapping[str, InputConfig]) -> None:
        self._device = device
        self._inputs = tuple(inputs.items())
        self._watched = any(c.stuck_on_s or c.stuck_off_s for c in inputs.values())
        self._since: list[float] = []
        self._changes: tuple[int, ...] = ()
        self._stuck: dict[str, float] = {}

    def begin(self, t: float, changes: tuple[int, ...]) -> None:
        """A new epoch: how long a level has lasted before is not known."""
        self._since, self._changes = [t] * len(self._inputs), changes

    def take(self, t: float, levels: tuple[bool, ...], changes: tuple[int, ...]) -> bool:
        """Whether an input is stuck as of the poll of time ``t`` (s); a pulse counts as a change."""
        if not self._watched:
            return False
        for index, (name, config) in enumerate(self._inputs):
            if changes[index] != self._changes[index]:
                self._since[index] = t
            limit = config.stuck_on_s if levels[index] else config.stuck_off_s
            lasted = t - self._since[index]
            stuck = limit is not None and lasted > limit
            if stuck and name not in self._stuck:
                self._stuck[name] = self._since[index]
                level = "on" if levels[index] else "off"
                log.warning("%s: %s is stuck %s: no change for %.1f s", self._device, name, level, lasted)
            elif not stuck and name in self._stuck:
                stood = t - self._stuck.pop(name)
                log.info("%s: %s changes again after %.1f s", self._device, name, stood)
        self._changes = changes
        return bool(self._stuck)

    def report(self, now: float) -> dict[str, float]:
        """Seconds since the last change of each input that is stuck."""
        return {name: now - since for name, since in self._stuck.items()}
