"""The plan of a dry run in words, by its kind."""

from collections.abc import Mapping
from typing import Any

from procedures.documents import kind_of
from procedures.kind import load


def plan_text(plan: Mapping[str, Any]) -> str:
    """What a job would do; ``KIND_UNKNOWN`` for a plan of a kind that is not known."""
    note = [str(plan["note"])] if plan.get("note") else []
    kind = kind_of({"kind": _kind_without_name(plan), **plan}, "plan")
    return "\n".join([*note, *load(kind.plan)(plan), "Nothing was moved."])


def _kind_without_name(plan: Mapping[str, Any]) -> str:
    """The kind of a plan from a daemon that does not write it: two have tables of their own."""
    if "source_rule" in plan:
        return "kincal"
    if "sweeps" in plan:
        return "laser"
    return "iso9283" if "arrivals" in plan else "hand-eye"
