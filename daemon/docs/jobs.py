"""``docs/jobs.md``: the state diagram of every job."""

from collections.abc import Mapping
from typing import Any

from daemon.docs.page import page

HEAD = """
# States of the jobs

Source: the transition table of each job in `procedures/`. From every state a job may also end by abort, halt
or an error. At a *checkpoint* it can be paused or finished with the arm at rest.
"""


def jobs_page(jobs: Mapping[str, Any]) -> str:
    """The text of ``docs/jobs.md``."""
    lines: list[str] = []
    for job in sorted(jobs.values(), key=lambda job: job.number):
        lines += [f"## {job.number} {job.name}", "", "```mermaid", "stateDiagram-v2"]
        lines += [f"    {s.name}: {s.name} (checkpoint)" for s in job.State if s in job.CHECKPOINTS]
        for source, targets in job.TRANSITIONS.items():
            start = "[*]" if source is None else source.name
            ends = [target.name for target in job.State if target in targets]
            if not targets or None in targets:
                ends.append("[*]")
            lines += [f"    {start} --> {end}" for end in ends]
        lines += ["```", ""]
    return page(HEAD, lines)
