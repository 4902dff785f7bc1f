"""What was determined: the rank, the combinations that no reading can tell apart, and the parameters."""

from collections.abc import Mapping
from typing import Any

from scipy.special import stdtrit

from procedures.report.html import Html, absent, bullets, el, facts, note, section, table
from procedures.report.numbers import DASH, dig, number
from procedures.tracker.report.source import KincalSource, kind_of

_SCALE = {"length": 1e3, "angle": 1e3, "ratio": 1.0}
_UNIT = {"length": "mm", "angle": "mrad", "ratio": ""}


def rank_section(source: KincalSource) -> Html:
    """How many combinations the readings determine, and in words what they leave open."""
    found = source.result.get("observability")
    title = "What the data could not determine"
    lacking = [f"Not determined by these poses: {w}." for w in dig(found, "unobservable") or []]
    if dig(found, "rank") is None:
        body = bullets(lacking) if lacking else absent("The result says nothing of what the data leave open.")
        return section(title, body)
    rows = [
        (
            "Rank",
            f"{dig(found, 'rank')} of {dig(found, 'parameters')}"
            if source.answer is not None
            else _rank(found),
            "Combinations of the parameters that the readings determine while the tracker's place is free.",
        ),
        (
            "with the tracker's place known",
            dig(found, "rank_without_registration") or DASH,
            "The rest of the difference looks like another place of the tracker.",
        ),
        (
            "possible for this arm",
            dig(found, "rank_possible") or DASH,
            "What the best poses determine; fewer means that these poses leave something open.",
        ),
    ]
    open_ = [str(words) for words in dig(found, "unidentifiable") or []]
    return section(
        title,
        facts(rows),
        bullets(lacking) if lacking else None,
        el("h3", "Combinations that no pose can tell apart") if open_ else None,
        bullets(open_),
        note(
            "Parameters in these combinations stay near nominal. They cancel in every prediction and "
            "do no harm; but none of them is right by itself."
        )
        if open_
        else None,
    )


def _rank(found: Any) -> str:
    return f"{dig(found, 'rank')} of {dig(found, 'rank_possible')} possible"


def rule_section(source: KincalSource) -> Html | None:
    """The rule of thumb for poses: checked and shown always, never the verdict by itself."""
    rule = dig(source.result, "observability", "source_rule")
    if not isinstance(rule, Mapping):
        return None
    smallest = number(dig(rule, "smallest_step_rad"))
    step = DASH if smallest is None else f"{smallest * 57.29577951308232:.2f}°"
    row = (
        "kept" if dig(rule, "kept") else "not kept",
        f"{dig(rule, 'samples')} poses, smallest step {step}",
        f"A rule of thumb asks for at least 50 poses, and for every joint more than 15° from pose to pose; "
        f"{dig(rule, 'short_steps')} steps are shorter. Poses chosen by observability need not keep it: what "
        "counts is the predicted error.",
    )
    return section("A rule of thumb for poses", facts([row]))


def parameters_section(source: KincalSource) -> Html | None:
    """Every parameter: nominal, calibrated, the difference, and its 95 % interval where it has one."""
    found, nominal = dig(source.answer, "parameters"), dig(source.answer, "nominal")
    if not isinstance(found, Mapping) or not found:
        return None
    sigma = dig(source.answer, "sigma")
    k95 = float(stdtrit(source.freedom, 0.975))
    rows = [_row(name, value, dig(nominal, name), sigma, k95) for name, value in found.items()]
    none = " This method gives no uncertainty." if sigma is None else ""
    return section(
        "Parameters",
        table(("parameter", "unit", "nominal", "calibrated", "change", "± 95 %"), rows, "llrrrr"),
        note(
            "A link is Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). 'open' is part of a combination above and "
            f"has no uncertainty of its own.{none} Judge an arm by its predictions, not by these numbers."
        ),
    )


def _row(name: str, value: Any, before: Any, sigma: Any, k95: float) -> list[object]:
    kind = kind_of(name)
    scale, unit = _SCALE[kind], _UNIT[kind]
    digits = 6 if kind == "ratio" else 4
    plain, nominal = number(value), number(before)
    change = None if plain is None or nominal is None else plain - nominal
    own = number(dig(sigma, name))
    spread = DASH if sigma is None else "open" if own is None else _shown(k95 * own, scale, digits)
    return [
        el("code", name),
        unit,
        _shown(nominal, scale, digits),
        _shown(plain, scale, digits),
        _shown(change, scale, digits),
        spread,
    ]


def _shown(value: float | None, scale: float, digits: int) -> str:
    if value is None:
        return DASH
    text = f"{scale * value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text.replace("-", "\N{MINUS SIGN}")
