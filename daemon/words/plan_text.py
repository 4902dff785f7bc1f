"""The plan of a dry run in words, by its kind."""

from collections.abc import Mapping
from typing import Any

from procedures.documents import kind_of
from procedures.kind import load


def plan_text(plan: Mapping[str, Any]) -> str:
    """What a job would do; ``KIND_UNKNOWN`` for a plan that says no kind, or one that is not known."""
    note = [str(plan["note"])] if plan.get("note") else []
    return "\n".join([*note, *load(kind_of(plan, "plan").plan)(plan), "Nothing was moved."])
