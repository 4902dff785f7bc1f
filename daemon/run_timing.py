"""How late the event loop was during a run, and how old the arm's state was whenever it was used."""

from collections.abc import Callable

from cell.devices import Arm
from cell.samples import Stream
from cell.time_histogram import TimeHistogram


class RunTiming:
    """Counts from its making until :meth:`end`.

    ``lag_into`` names the distribution that every lag of the loop is counted in from now on. An age of the
    arm's state counts when a sample is judged as it comes, and whenever the newest one is asked for.
    """

    def __init__(self, lag_into: Callable[[TimeHistogram | None], None], arm: Arm | None) -> None:
        self._lag_into = lag_into
        self._lags, self._ages = TimeHistogram(), TimeHistogram()
        state = arm.state if arm is not None else None
        self._state = state if isinstance(state, Stream) else None
        lag_into(self._lags)
        if self._state is not None:
            self._state.ages = self._ages

    def end(self) -> dict[str, dict[str, float]]:
        """Stop counting; ``loop_lag`` and, with an arm, ``state_age``: each a ``TimeHistogram.summary``."""
        self._lag_into(None)
        if self._state is None:
            return {"loop_lag": self._lags.summary()}
        self._state.ages = None
        return {"loop_lag": self._lags.summary(), "state_age": self._ages.summary()}
