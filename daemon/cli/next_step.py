"""What can be done next, as the exact commands: by the state of the daemon, and after a run."""

from collections.abc import Mapping, Sequence
from typing import Any

WARNED = " --warned"


def next_commands(end: Mapping[str, Any], waiting: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sentences with the commands that follow the run that ended as ``end`` (``last_run`` of the status).

    ``waiting`` are the results that wait for a decision; those of other runs are left out.
    """
    answer = (end.get("result") or {}).get("result") or {}
    lines = []
    if (answer.get("moved") or {}).get("moved"):
        lines.append(f"The tool has moved. To correct its frame: {start_of('laser-update', end)}.")
    own = [entry for entry in waiting if entry["run_id"] == end["run_id"]]
    return lines + [to_decide(entry, end.get("verdict")) for entry in own]


def start_of(job: str, said: Mapping[str, Any]) -> str:
    """The command that starts ``job`` with the tool that a status or one of its entries names, if it does."""
    return f"cellward start {job}" + (f" -p tool={said['tool']}" if said.get("tool") else "")


def to_decide(entry: Mapping[str, Any], verdict: str | None = None) -> str:
    """How to decide about one result; one with warnings is accepted by saying that they were read."""
    accept = f"cellward accept {entry['id']}{WARNED if verdict == 'warn' else ''}"
    return f"To decide about {entry['name']}: {accept}, or cellward reject {entry['id']}."


def possible(status: Mapping[str, Any]) -> str:
    """The commands that the daemon takes in its present state."""
    state = status["packml"]
    if prompt := status.get("prompt"):
        skip = [f"skip {prompt['id']}"] if prompt.get("skippable") else []
        verbs = [f"confirm {prompt['id']}", *skip, "finish", "abort", "halt"]
    elif status.get("job"):
        stopping = state in ("STOPPING", "ABORTING", "COMPLETING", "CLEARING")
        held = state in ("HELD", "HOLDING", "SUSPENDED")
        verbs = [] if stopping else ["resume" if held else "pause", "finish", "abort", "halt"]
    elif status.get("latched"):
        verbs = ["reset"]
    else:
        verbs = ["start JOB", "start JOB --dry-run", *(["reset"] if status.get("error") else [])]
    if not verbs:
        return "nothing: the job is ending; wait for its end"
    return ", ".join(f"cellward {verb}" for verb in verbs)
