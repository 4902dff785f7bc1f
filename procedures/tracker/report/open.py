"""What was determined: the rank, the combinations that no reading can tell apart, and the parameters."""

from collections.abc import Mapping

from scipy.special import stdtrit

from procedures.report.html import Html, bullets, el, facts, note, section, table
from procedures.report.numbers import DASH
from procedures.tracker.report.source import KincalSource, kind_of

_SCALE = {"length": 1e3, "angle": 1e3, "ratio": 1.0}
_UNIT = {"length": "mm", "angle": "mrad", "ratio": ""}
_RANK = "Combinations of the parameters that the readings determine while the tracker's place is free."
_POSSIBLE = "What the best poses determine; fewer means that these poses leave something open."


def rank_section(source: KincalSource) -> Html:
    """How many combinations the readings determine, and in words what they leave open."""
    title = "What the data could not determine"
    if source.found is None:
        return _refused(source, title)
    found = source.found.observability
    rows = [
        (
            "Rank",
            f"{found.rank} of {found.parameters}",
            _RANK,
        ),
        (
            "with the tracker's place known",
            found.rank_without_registration,
            "The rest of the difference looks like another place of the tracker.",
        ),
        ("possible for this arm", found.rank_possible, _POSSIBLE),
    ]
    return _open(title, rows, found.unobservable, found.unidentifiable)


def _refused(source: KincalSource, title: str) -> Html:
    """The same of data that determine no answer, as far as it is known."""
    rank, possible = source.known("rank"), source.known("rank_possible")
    rows = []
    if rank is not None:
        rows = [
            ("Rank", f"{rank} of {possible} possible", _RANK),
            ("possible for this arm", possible, _POSSIBLE),
        ]
    return _open(title, rows, source.known("unobservable") or [], source.known("unidentifiable") or [])


def _open(title: str, rows: list[tuple[str, object, str]], lacking: list[str], open_: list[str]) -> Html:
    return section(
        title,
        facts(rows) if rows else None,
        bullets(f"Not determined by these poses: {words}." for words in lacking) if lacking else None,
        el("h3", "Combinations that no pose can tell apart") if open_ else None,
        bullets(open_),
        note(
            "Parameters in these combinations stay near nominal. They cancel in every prediction and "
            "do no harm; but none of them is right by itself."
        )
        if open_
        else None,
    )


def rule_section(source: KincalSource) -> Html | None:
    """The rule of thumb for poses: checked and shown always, never the verdict by itself."""
    if source.found is None:
        return None
    rule = source.found.observability.source_rule
    smallest = rule.smallest_step_rad
    step = DASH if smallest is None else f"{smallest * 57.29577951308232:.2f}°"
    row = (
        "kept" if rule.kept else "not kept",
        f"{rule.samples} poses, smallest step {step}",
        f"A rule of thumb asks for at least 50 poses, and for every joint more than 15° from pose to pose; "
        f"{rule.short_steps} steps are shorter. Poses chosen by observability need not keep it: what "
        "counts is the predicted error.",
    )
    return section("A rule of thumb for poses", facts([row]))


def parameters_section(source: KincalSource) -> Html | None:
    """Every parameter: nominal, calibrated, the difference, and its 95 % interval where it has one."""
    if source.found is None:
        return None
    answer = source.found.result
    sigma = answer.sigma
    k95 = float(stdtrit(source.freedom, 0.975))
    rows = [
        _row(name, value, answer.nominal.get(name), sigma, k95) for name, value in answer.parameters.items()
    ]
    none = " This method gives no uncertainty." if sigma is None else ""
    return section(
        "Parameters",
        table(("parameter", "unit", "nominal", "calibrated", "change", "± 95 %"), rows, "llrrrr"),
        note(
            "A link is Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). 'open' is part of a combination above and "
            f"has no uncertainty of its own.{none} Judge an arm by its predictions, not by these numbers."
        ),
    )


def _row(
    name: str, value: float, nominal: float | None, sigma: Mapping[str, float | None] | None, k95: float
) -> list[object]:
    kind = kind_of(name)
    scale, unit = _SCALE[kind], _UNIT[kind]
    digits = 6 if kind == "ratio" else 4
    change = None if nominal is None else value - nominal
    own = None if sigma is None else sigma.get(name)
    spread = DASH if sigma is None else "open" if own is None else _shown(k95 * own, scale, digits)
    return [
        el("code", name),
        unit,
        _shown(nominal, scale, digits),
        _shown(value, scale, digits),
        _shown(change, scale, digits),
        spread,
    ]


def _shown(value: float | None, scale: float, digits: int) -> str:
    if value is None:
        return DASH
    text = f"{scale * value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text.replace("-", "\N{MINUS SIGN}")
