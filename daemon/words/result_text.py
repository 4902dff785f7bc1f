"""A result in words: what was found, how sure it is, and what it does not say."""

from collections.abc import Mapping
from typing import Any

from cell.run_values import CONTROLLER
from procedures.documents import kind_of, read_result
from procedures.kind import load
from procedures.kinematics_in_use import in_words


def result_text(result: Mapping[str, Any], where: str = "the result") -> str:
    """The summary of a whole result document, found ``where``; ``KIND_UNKNOWN``, ``RESULT_INVALID``."""
    kind = kind_of(result)
    lines = [f"{kind.name}: verdict {result.get('verdict')}"]
    warnings = result.get("warnings") or []
    told = {warning["text"] for warning in warnings}
    lines += [f"  because: {reason}" for reason in result.get("reasons") or [] if reason not in told]
    if result.get("result") is None:
        lines.append("  no answer: the data cannot determine it")
    else:
        lines += load(kind.words)(read_result(result, where))
    lines += [f"  warning {w['code']}: {w['text']}" for w in warnings]
    if (model := (result.get("inputs") or {}).get("arm_model")) and model["name"] != CONTROLLER["name"]:
        lines.append(f"  arm by {in_words(model)}")
    if again := (result.get("inputs") or {}).get("steps_taken_again"):
        lines.append(f"  steps taken again after a short silence of a device: {len(again)}")
        lines += [f"    {entry['step']}: {entry['why']}, {entry['lost_s']:.1f} s lost" for entry in again]
    return "\n".join(lines)
