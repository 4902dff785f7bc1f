"""Who asked for what lately, over any channel: what every page shows, so that nobody acts unseen."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from cell.store.ledger import Ledger
from daemon.auditor import Audit

KEPT = 20


class RecentWrites:
    """The newest audit lines in memory, oldest first; a ledger that is locked or full delays none.

    Accepted ones and refused ones are kept apart: a stranger who is refused all the time hides nobody.
    """

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._accepted: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._refused: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._listeners: list[Callable[[], None]] = []
        self.number = 0

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call ``listener`` after every line, in the thread that wrote it; what is returned ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def audit(self, channel: str) -> Audit:
        """What audits one channel; called in threads."""

        def note(who: str, what: str, accepted: bool, detail: str) -> None:
            self.number += 1
            line = {"channel": channel, "who": who, "what": what, "accepted": accepted, "detail": detail}
            lines = self._accepted if accepted else self._refused
            lines.append({"number": self.number, "at": time.time(), **line})
            for listener in tuple(self._listeners):
                listener()
            self._ledger.audit(channel, who, what, accepted, detail)

        return note

    def newest(self, count: int = KEPT) -> list[dict[str, Any]]:
        """The newest ``count`` lines, oldest first; half of them are kept for accepted ones, if there are."""
        accepted, refused = list(self._accepted)[-count:], list(self._refused)
        refused = refused[-max(count // 2, count - len(accepted)) :]
        accepted = accepted[len(accepted) - (count - len(refused)) :] if len(refused) < count else []
        return sorted([*accepted, *refused], key=lambda line: int(line["number"]))
