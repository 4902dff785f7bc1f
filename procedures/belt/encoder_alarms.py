"""What an encoder reports of itself while a job works with its counts."""

from collections.abc import Callable

from cell.devices import Encoder, EncoderState
from cell.formats.result import Warning_
from cell.samples import Quality, Sample


class Emergencies:
    """Told of every count; each kind of emergency is told on once, in the words of the driver.

    None of them ends a job: which of a maker's codes leave the position good is unknown. What is wrong
    with the counts themselves is found by their own checks.
    """

    def __init__(self, encoder: Encoder, tell: Callable[[str], None]) -> None:
        self._encoder, self._tell = encoder, tell
        self.told: list[str] = []

    def count(self, sample: Sample[EncoderState]) -> None:
        """A count has come."""
        if sample.quality is Quality.GOOD:
            return
        words = self._encoder.health().get("emergency") or "counts of less than good quality"
        if words not in self.told:
            self.told.append(words)
            self._tell(words)


def emergency_warnings(told: list[str]) -> list[Warning_]:
    """For the result of a run in which the encoder said this."""
    if not told:
        return []
    text = f"the encoder reported {'; '.join(told)}: look at it before its counts are relied on"
    return [Warning_(code="belt.encoder-emergency", text=text)]
