"""The newest lines of the log in memory, for the page."""

import logging
from collections import deque
from typing import Any

KEPT = 300
LONGEST = 500


class RecentLog(logging.Handler):
    """Keeps what the log says, bounded; ``with RecentLog() as log`` listens until the end of the block."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[dict[str, Any]] = deque(maxlen=KEPT)

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().replace("\n", " ")[:LONGEST]
        level = record.levelname.lower()
        self._lines.append({"at": record.created, "level": level, "logger": record.name, "text": text})

    def lines(self) -> list[dict[str, Any]]:
        """Oldest first."""
        return list(self._lines)

    def __enter__(self) -> "RecentLog":
        logging.getLogger().addHandler(self)
        return self

    def __exit__(self, *exc: object) -> None:
        logging.getLogger().removeHandler(self)
