"""The top of every report: the verdict with its reasons, what to do about them, and figures to take away."""

from collections.abc import Iterable, Mapping
from typing import Any

from procedures.report.html import Html, bullets, el, paragraph
from procedures.report.numbers import dig
from procedures.report.source import Source

_HEADLINE = {
    "pass": "Pass",
    "warn": "Pass with warnings",
    "fail": "Fail",
}


def banner(
    source: Source[Any], remedies: Mapping[str, str], otherwise: str, more: Html | None = None
) -> Html:
    """The verdict and why. ``remedies`` says what to do by the name that a refusal begins with."""
    result = source.result
    refused = getattr(result, "result", None) is None
    headline = "Refused: the data cannot determine the answer" if refused else _HEADLINE[result.verdict]
    if source.altered:
        headline = "Altered after the run's end: what follows is not what the job found"
    unfinished = dig(source.end, "outcome") not in (None, "complete")
    if unfinished:
        headline += f" (but the run ended {dig(source.end, 'outcome')})"
    told = {warning.text for warning in result.warnings}
    reasons = [reason for reason in result.reasons if reason not in told]
    remedy = remedies.get(_name(source))
    body: list[object] = []
    if reasons:
        body.append(bullets(reasons))
    if refused or (remedy is not None and result.verdict == "fail"):
        body.append(paragraph(el("b", "What to do. "), remedy or otherwise))
    if result.warnings:
        body.append(bullets(el("span", el("code", w.code), " ", w.text) for w in result.warnings))
    if not body:
        body.append(paragraph("No finding: the data determine the answer and nothing is to be warned of."))
    more = Html((more or "") + (_decision(source) or ""))
    kind = "warn" if unfinished and result.verdict == "pass" else result.verdict
    kind = "fail" if source.altered else kind
    return el("div", el("h2", headline), *body, more, class_=f"verdict {kind}")


def _decision(source: Source[Any]) -> Html | None:
    """What became of the result when this report was drawn, or the commands that decide about it."""
    told = [e for e in source.journal if e.get("kind") == "decision" and e.get("result_id") is not None]
    proposed = [e for e in told if e.get("event") == "proposed"]
    if not proposed:
        return None
    number, name = proposed[-1]["result_id"], proposed[-1].get("name")
    if any(row["id"] == number and row["state"] != "proposed" for row in source.decided):
        return None  # the first page says by whom and when
    became = {e.get("event") for e in told if e["result_id"] == number}
    if became & {"committed", "rejected"}:
        return None  # the job decided itself, and its report says how
    if "accepted" in became:
        return paragraph(f"Result {number} ({name}) was accepted by policy when the run ended.")
    accept = f"cellward accept {number}{' --warned' if source.result.verdict == 'warn' else ''}"
    return paragraph(
        el("b", "What next. "),
        f"When this report was drawn, result {number} ({name}) waited for a decision: ",
        el("code", accept),
        " or ",
        el("code", f"cellward reject {number}"),
        "; ",
        el("code", "cellward results"),
        " says what became of it.",
    )


def _name(source: Source[Any]) -> str:
    """The fixed name of what was found: ``parallel-axes`` of "parallel-axes: all rotations ..."."""
    return str(source.known("refused") or next(iter(source.result.reasons), "").split(":")[0])


def cards(figures: Iterable[tuple[str, str]]) -> Html:
    """Figures to take away, each with what it means."""
    return el(
        "div", *(el("div", el("b", v), el("span", w), class_="card") for v, w in figures), class_="cards"
    )
