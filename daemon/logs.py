"""One log record is one line: ``<n>text`` for journald, or JSON."""

import json
import logging
import os
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Literal, TextIO

Format = Literal["prefix", "json", "plain"]
_PRIORITY = {logging.CRITICAL: 2, logging.ERROR: 3, logging.WARNING: 4, logging.INFO: 6, logging.DEBUG: 7}
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
# Libraries that dump packets or chat at levels that are not ours.
_QUIET = ("pymodbus", "can", "aiohttp.access", "asyncio")


def set_up_logging(
    level: str | None = None,
    style: Format | None = None,
    stream: TextIO | None = None,
    environment: Mapping[str, str] = os.environ,
) -> None:
    """Send all records to ``stream`` (standard error).

    ``level`` falls back to ``$CELLWARD_LOG_LEVEL`` and INFO, ``style`` to ``$CELLWARD_LOG_FORMAT``; without
    either it is ``prefix`` under journald, and ``plain`` (with the time) elsewhere.
    """
    wanted = (level or environment.get("CELLWARD_LOG_LEVEL") or "INFO").upper()
    number = logging.getLevelNamesMapping().get(wanted, logging.INFO)
    chosen = style or environment.get("CELLWARD_LOG_FORMAT")
    if chosen not in ("prefix", "json", "plain"):
        chosen = "prefix" if "JOURNAL_STREAM" in environment else "plain"
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(_FORMATTERS[chosen]())
    root = logging.getLogger()
    for old in tuple(root.handlers):
        root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(number)
    for name in _QUIET:
        logging.getLogger(name).setLevel(max(number, logging.WARNING))
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


class PrefixFormatter(logging.Formatter):
    """``<priority>logger: text``; journald takes the number as the level and adds the time itself."""

    def format(self, record: logging.LogRecord) -> str:
        return f"<{_priority(record.levelno)}>{record.name}: {_text(record, self)}{_fields(record)}"


class PlainFormatter(logging.Formatter):
    """For people: local time, level, logger, text."""

    def format(self, record: logging.LogRecord) -> str:
        time = datetime.fromtimestamp(record.created).astimezone().isoformat(timespec="milliseconds")
        return f"{time} {record.levelname.lower()} {record.name}: {_text(record, self)}{_fields(record)}"


class JsonFormatter(logging.Formatter):
    """One JSON object a line: time (UTC), level, logger, text, and what ``extra`` gave."""

    def format(self, record: logging.LogRecord) -> str:
        entry: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "text": record.getMessage(),
            **_extra(record),
        }
        if record.exc_info:
            entry["traceback"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False, default=str)


_FORMATTERS: dict[str, type[logging.Formatter]] = {
    "prefix": PrefixFormatter,
    "plain": PlainFormatter,
    "json": JsonFormatter,
}


def _priority(level: int) -> int:
    return next((n for limit, n in _PRIORITY.items() if level >= limit), 7)


def _text(record: logging.LogRecord, formatter: logging.Formatter) -> str:
    """The message, and a traceback on the same line: a line break would begin another record."""
    text = record.getMessage()
    if record.exc_info:
        text += "\n" + formatter.formatException(record.exc_info)
    return text.replace("\r", "").replace("\n", " | ")


def _fields(record: logging.LogRecord) -> str:
    return "".join(f" {key}={value}" for key, value in _extra(record).items())


def _extra(record: logging.LogRecord) -> dict[str, Any]:
    return {k: v for k, v in vars(record).items() if k not in _STANDARD}
