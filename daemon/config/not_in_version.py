"""Sections and jobs whose names are reserved: this version does nothing with them, and says so."""

from typing import Any

from daemon.config.findings import Findings

SECTIONS = {"can": "The CAN trigger"}
JOBS = ("eye-to-hand-check", "slot-insertion", "drift-check")


def take_out(raw: dict[str, Any], findings: Findings) -> dict[str, Any]:
    """``raw`` without what this version does not have, one finding for each.

    A section that is switched off asks for nothing, so it is only warned of.
    """
    for name, what in SECTIONS.items():
        if name not in raw:
            continue
        section = raw[name]
        if isinstance(section, dict) and section.get("enabled") is False:
            findings.warn((name,), f"{what} is not in this version; the section has no effect, remove it")
        else:
            findings.add((name,), f"{what} is not in this version; remove the section [{name}]")
    kept = {key: value for key, value in raw.items() if key not in SECTIONS}
    jobs = raw.get("job")
    if isinstance(jobs, dict):
        for name in JOBS:
            if name in jobs:
                findings.add(("job", name), f"the job '{name}' is not in this version; remove the section")
        kept["job"] = {name: section for name, section in jobs.items() if name not in JOBS}
    return kept
