"""Whether the place is clear where an item is put down, by an input, and how often that was waited for."""

from cell.clock import Clock
from cell.devices import DigitalInputs
from cell.errors import CellError, error

READING_AGE_S = 0.1  # an older reading says nothing of now


class PlaceClear:
    """The input ``name`` of ``inputs``; without inputs the place is always clear."""

    def __init__(self, inputs: DigitalInputs | None, name: str | None) -> None:
        """``ARGUMENT_INVALID`` when there is no such input."""
        self._inputs, self._index, self._name = inputs, 0, name
        self.last_obstacle: str | None = None  # what kept an item from being put down last
        if inputs is not None:
            if name not in inputs.names:
                known = ", ".join(inputs.names)
                raise error(
                    "ARGUMENT_INVALID", f"place_clear = '{name}' is no input of {inputs.name}: it has {known}"
                )
            self._index = inputs.names.index(name)

    def obstacle(self) -> str | None:
        """Why nothing may be put down now, in words; None while the place is clear."""
        if (found := self._obstacle()) is not None:
            self.last_obstacle = found
        return found

    def taken_on_the_way_down(self) -> bool:
        """:meth:`obstacle`, looked for by a tool that is already below the level way."""
        if (found := self._obstacle()) is None:
            return False
        self.last_obstacle = f"while the tool went down, {found}"
        return True

    def _obstacle(self) -> str | None:
        if self._inputs is None:
            return None
        try:
            reading = self._inputs.inputs.latest(READING_AGE_S)
        except CellError as exc:
            return f"the place is not known to be clear: {exc.detail}"
        return None if reading.value.levels[self._index] else f"the place is not clear: '{self._name}' is off"


class PlaceWaits:
    """The times for which the arm had to wait, with an item, until the place was clear; s."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self._since = clock, 0.0
        self.count, self.total_s, self.longest_s = 0, 0.0, 0.0

    def begin(self) -> None:
        """The arm rests with an item."""
        self._since = self._clock.now()
        self.count += 1

    def end(self) -> None:
        """The place is clear, or the job ends."""
        waited = self._clock.now() - self._since
        self.total_s += waited
        self.longest_s = max(self.longest_s, waited)
