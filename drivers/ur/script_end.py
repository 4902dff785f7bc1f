"""Whose end of our control script was it: our own watchdog's, somebody else's, or unknown?

A script that a person stopped at the pendant must never be started again by us. So two records are
compared: the arm's samples, which show when the script ended, and the kicks that the motion child told of
before it sent them. The controller's watchdog needs a time without kicks; what ends the script earlier is
somebody else.
"""

from collections import deque
from enum import Enum

from cell.samples import GAP_S
from drivers.ur.feed import PLAYING, STOPPED, STOPPING

# The latest kick that was told of may not have left the child, and stamps are good for a few milliseconds.
TOLD_EARLY_S = 0.03
# Below this, a time without kicks is an ordinary one, however impatient the watchdog is.
LEAST_S = 0.04
SEEN_S = 0.1  # from the end of a lapse to the sample that shows that the script runs no more


class Kicks:
    """When the controller had kicks, as the motion child told; s, monotonic."""

    def __init__(self) -> None:
        self._latest = float("inf")  # none yet
        self._lapses: deque[tuple[float, float]] = deque(maxlen=16)

    def note(self, at: float) -> None:
        """The child sent a kick at ``at``."""
        if at - self._latest > LEAST_S:
            self._lapses.append((self._latest, at))
        self._latest = at

    def lapsed_at(self, t: float, patience_s: float) -> bool:
        """Whether a watchdog that waits ``patience_s`` had reason to end the script by ``t``."""
        least = max(patience_s - TOLD_EARLY_S, LEAST_S)
        lapses = [*self._lapses, (self._latest, float("inf"))]
        return any(since + least < t < until + SEEN_S and until - since > least for since, until in lapses)


class ScriptEnd(Enum):
    """What became of our script."""

    NONE = "it runs"
    OURS = "our own watchdog, or our own command, ended it"
    OTHERS = "somebody else ended it"
    UNSEEN = "it ended while the arm was not seen"


class ScriptRecord:
    """Follows the runtime state of every package from the upload of our script to its end.

    The program that starts after :meth:`expect` is ours until it is seen stopped; later ones are not.
    """

    def __init__(self, kicks: Kicks, patience_s: float) -> None:
        self.runs = False
        self.lost = False  # the link that shows the arm ended
        self._kicks, self._patience_s = kicks, patience_s
        self._expected = self._asked = False
        self._before = self._left = float("-inf")  # the latest samples that showed it playing, and not
        self._end: tuple[float, float] | None = None

    def expect(self) -> None:
        """Our script is about to be uploaded."""
        self._expected = True

    def ask_end(self) -> None:
        """We are about to end our script by a command."""
        self._asked = self._asked or (self.runs and self._end is None)

    def note(self, runtime_state: int, t: float) -> None:
        """One package: true of the controller at ``t``, s, monotonic."""
        if self._expected and runtime_state == PLAYING:
            self._expected, self.runs = False, True
        if not self.runs:
            return
        if runtime_state == PLAYING:
            self._before = t
        elif self._before > self._left:
            self._left = t
        if runtime_state in (STOPPING, STOPPED):  # known before the arm is at rest; a pause is no end
            self._end = self._before, self._left
        if runtime_state == STOPPED:
            self.runs = False

    @property
    def end(self) -> ScriptEnd:
        """Whose end it was, by what is known now; doubt is not ours."""
        if self._asked:
            return ScriptEnd.OURS
        if self._end is None:
            return ScriptEnd.UNSEEN if self.lost else ScriptEnd.NONE
        before, ended = self._end
        if ended - before > GAP_S:
            return ScriptEnd.UNSEEN
        return ScriptEnd.OURS if self._kicks.lapsed_at(ended, self._patience_s) else ScriptEnd.OTHERS
