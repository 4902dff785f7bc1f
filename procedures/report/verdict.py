"""The top of every report: the verdict with its reasons, what to do about them, and figures to take away."""

from collections.abc import Iterable, Mapping

from procedures.report.html import Html, bullets, el, paragraph
from procedures.report.numbers import dig
from procedures.report.source import Source

_HEADLINE = {
    "pass": "Pass",
    "warn": "Pass with warnings",
    "fail": "Fail",
}


def banner(source: Source, remedies: Mapping[str, str], otherwise: str, more: Html | None = None) -> Html:
    """The verdict and why. ``remedies`` says what to do by the name that a refusal begins with."""
    result = source.result
    verdict = str(result.get("verdict"))
    refused = source.answer is None
    headline = "Refused: the data cannot determine the answer" if refused else _HEADLINE.get(verdict, verdict)
    unfinished = dig(source.end, "outcome") not in (None, "complete")
    if unfinished:
        headline += f" (but the run ended {dig(source.end, 'outcome')})"
    warnings = [w for w in result.get("warnings") or [] if isinstance(w, Mapping)]
    told = {w.get("text") for w in warnings}
    reasons = [r for r in result.get("reasons") or [] if r not in told]
    remedy = remedies.get(_name(source))
    body: list[object] = []
    if reasons:
        body.append(bullets(reasons))
    if refused or (remedy is not None and verdict == "fail"):
        body.append(paragraph(el("b", "What to do. "), remedy or otherwise))
    if warnings:
        body.append(bullets(el("span", el("code", w.get("code")), " ", w.get("text")) for w in warnings))
    if not body:
        body.append(paragraph("No finding: the data determine the answer and nothing is to be warned of."))
    more = Html((more or "") + (_decision(source) or ""))
    kind = verdict if verdict in _HEADLINE else "fail"
    if unfinished and kind == "pass":
        kind = "warn"
    return el("div", el("h2", headline), *body, more, class_=f"verdict {kind}")


def _decision(source: Source) -> Html | None:
    """What became of the result when this report was drawn, or the commands that decide about it."""
    if dig(source.result, "inputs", "update") is not None:
        return None  # an update decides itself, and its report says how
    told = [e for e in source.journal if e.get("kind") == "decision" and e.get("result_id") is not None]
    proposed = [e for e in told if e.get("event") == "proposed"]
    if not proposed:
        return None
    number, name = proposed[-1]["result_id"], proposed[-1].get("name")
    if any(e.get("event") == "accepted" and e["result_id"] == number for e in told):
        return paragraph(f"Result {number} ({name}) was accepted by policy when the run ended.")
    accept = f"cellward accept {number}{' --warned' if source.result.get('verdict') == 'warn' else ''}"
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


def _name(source: Source) -> str:
    """The fixed name of what was found: ``parallel-axes`` of "parallel-axes: all rotations ..."."""
    name = dig(source.result, "observability", "refused")
    if name is None:
        name = str(next(iter(source.result.get("reasons") or [""]))).split(":")[0]
    return str(name)


def cards(figures: Iterable[tuple[str, str]]) -> Html:
    """Figures to take away, each with what it means."""
    return el(
        "div", *(el("div", el("b", v), el("span", w), class_="card") for v, w in figures), class_="cards"
    )
