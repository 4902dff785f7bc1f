"""Jobs whose names are reserved: this version does nothing with them, and says so."""

from typing import Any

from daemon.config.findings import Findings

JOBS = ("drift-check",)


def take_out(raw: dict[str, Any], findings: Findings) -> dict[str, Any]:
    """``raw`` without what this version does not have, one finding for each."""
    jobs = raw.get("job")
    if not isinstance(jobs, dict):
        return raw
    for name in JOBS:
        if name in jobs:
            findings.add(("job", name), f"the job '{name}' is not in this version; remove the section")
    return {**raw, "job": {name: section for name, section in jobs.items() if name not in JOBS}}
