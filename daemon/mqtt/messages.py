"""The documents that the broker gets, SI units as everywhere; ``at`` is UTC."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from cell.store.run_fields import tool_on_flange
from cell.store.runs import RunFolder
from cell.store.summary import summary
from cell.version import software

STATE_SCHEMA, RUN_SCHEMA, ALARM_SCHEMA = (
    "cellward.mqtt-state/1",
    "cellward.mqtt-run/1",
    "cellward.mqtt-alarm/1",
)
_SHOWN = ("cell", "twin", "packml", "job", "tool", "run_id", "state", "step", "steps", "latched")


def state_message(status: Mapping[str, Any]) -> dict[str, Any]:
    """What stands in status, without what changes all the time: it is sent when it differs."""
    prompt = status["prompt"]
    return {
        "schema": STATE_SCHEMA,
        **{key: status[key] for key in _SHOWN},
        "prompt": None if prompt is None else prompt.get("text"),
        "error": status["error"],
        "results_waiting": len(status["waiting"]),
        "devices": {name: device["state"] for name, device in status["devices"].items()},
        "software": software(),
    }


def alarm_message(failure: Mapping[str, Any] | None, run_id: int | None, at: float) -> dict[str, Any]:
    """An error that came, or null when the last one is over."""
    return {
        "schema": ALARM_SCHEMA,
        "at": datetime.fromtimestamp(at, UTC).isoformat(),
        "run_id": run_id,
        "error": None if failure is None else dict(failure),
    }


def run_message(folder: RunFolder, end: Mapping[str, Any]) -> dict[str, Any]:
    """A run that ended: who and what, how it ended, and the short of its result."""
    result = folder.read_result()
    return {
        "schema": RUN_SCHEMA,
        "run_id": folder.run_id,
        "job": folder.job,
        "recipe": folder.info.get("recipe"),
        "tool": tool_on_flange(folder.info),
        "folder": folder.path.name,
        "started": folder.info.get("started"),
        "ended": end.get("ended"),
        "outcome": end.get("outcome"),
        "verdict": end.get("verdict"),
        "error": end.get("error"),
        "result": None if result is None else summary(result),
        "software": end.get("software"),
    }
