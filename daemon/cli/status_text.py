"""The daemon's status in words."""

from collections.abc import Mapping, Sequence
from typing import Any

from daemon.cli.next_step import next_commands, possible, start_of, to_decide
from procedures.words import table


def status_text(status: Mapping[str, Any]) -> str:
    """The whole status, with what can be done about it."""
    lines = [f"{status['cell']}{' (twin)' if status.get('twin') else ''}: {status['packml']}"]
    if status.get("job"):
        lines.append(f"job       {job_text(status)}")
    if prompt := status.get("prompt"):
        lines += [f"prompt    {prompt['text']}", f"          then: cellward confirm {prompt['id']}"]
    if failure := status.get("error"):
        lines += [f"error     {failure['text']} ({failure['code']})", f"          {failure['hint']}"]
    if status.get("latched"):
        lines.append("motion    locked after a fault; clear the cause, then: cellward reset")
    if last := status.get("last_run"):
        lines.append(f"last run  {_last_run(last)}")
        lines += [f"          {reason}" for reason in ((last.get("result") or {}).get("reasons") or [])[:1]]
        lines += [f"          {text}" for text in next_commands(last, status.get("waiting", []))]
    if (told := status.get("program_start")) is not None:
        lines.append(f"program   {told['text']}")
        if told["state"] == "starting":
            lines.append("          to keep it from starting: cellward halt")
    seen = last["run_id"] if last else None
    others = [entry for entry in status.get("waiting", []) if entry["run_id"] != seen]
    lines += [f"waits     {to_decide(entry)}" for entry in others]
    lines += [f"          run {r} was interrupted; cellward adopt {r}" for r in status.get("interrupted", [])]
    lines.append(f"possible  {possible(status)}")
    if damage := status.get("ledger_damage"):
        from daemon.state_folder import damage_text  # it imports asyncio

        lines += [f"ledger    {damage_text(damage)}", "          then: cellward acknowledge-ledger"]
    lines += [f"due       {text}" for text in due_words(status.get("due", []))]
    if warning := (status.get("disk") or {}).get("warning"):
        lines.append(f"disk      {warning}")
    lines += ["", table(("device", "state", "model", "serial", "error"), _devices(status))]
    return "\n".join(lines)


def due_words(due: Sequence[Mapping[str, Any]]) -> list[str]:
    """A sentence for each calibration that wants to be checked, with the command that does it."""
    return [
        f"{entry['name']}: {entry['why']}" + (f"; {start_of(entry['job'], entry)}" if entry["job"] else "")
        for entry in due
    ]


def job_text(status: Mapping[str, Any]) -> str:
    """The job, its state and how far it is."""
    steps = f", {status['step']} of {status['steps']}" if status.get("steps") else ""
    where = f"{status.get('state') or 'starting'}{steps}{again_text(status)}"
    return f"{status['job']}{tool_text(status)}, run {status['run_id']}: {where}"


def tool_text(said: Mapping[str, Any]) -> str:
    """Which tool it is of, in a cell that has several."""
    return f" of tool '{said['tool']}'" if said.get("tool") else ""


def again_text(status: Mapping[str, Any]) -> str:
    """How often a short silence of a device cost a step, if it did."""
    count = status.get("steps_taken_again") or 0
    return f"; {count} step{'s' * (count > 1)} taken again after a short silence" if count else ""


def change_line(status: Mapping[str, Any]) -> str:
    """The status on one line; equal lines mean that nothing worth telling changed."""
    parts = [status["packml"]]
    if status.get("job"):
        parts.append(job_text(status))
    if prompt := status.get("prompt"):
        parts.append(f"prompt {prompt['id']}: {prompt['text']}")
    if failure := status.get("error"):
        parts.append(f"error {failure['code']}: {failure['text']}")
    parts += [
        f"{name} {device['state']}"
        for name, device in status.get("devices", {}).items()
        if device["state"] != "READY"
    ]
    return " | ".join(parts)


def without_state(status: Mapping[str, Any]) -> str:
    """As :func:`change_line`, without the state within the job's step."""
    return change_line({**status, "state": "-"})


def _last_run(last: Mapping[str, Any]) -> str:
    text = f"{last['run_id']} ({last['job']}{tool_text(last)}): {last['outcome']}"
    if last.get("verdict"):
        text += f", verdict {last['verdict']}"
    return f"{text}{again_text(last)}; cellward show {last['run_id']}"


def _devices(status: Mapping[str, Any]) -> list[tuple[Any, ...]]:
    return [
        (name, device["state"], device.get("model"), device.get("serial"), device.get("error"))
        for name, device in status.get("devices", {}).items()
    ]
