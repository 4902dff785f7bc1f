"""The limits of the job beside the figures of a crossed-beam measurement."""

from collections.abc import Callable
from typing import Any

from procedures.laser.odds_words import odds_of
from procedures.laser.report.source import LaserSource
from procedures.report.html import Html, absent, note, section, table
from procedures.report.numbers import DASH, deg, dig, mm, number

Row = tuple[str, Any, Any, Callable[[Any], str]]  # name, value, limit, how it is shown


def limits_section(source: LaserSource) -> Html | None:
    """Against the reference, against the frame in effect, and the uncertainty that is allowed."""
    if source.found is None:
        return None
    limits = dig(source.run, "job_config")
    judged = [_judged(*row) for row in limit_rows(source)]
    if not judged:
        words = "No limits were set: this result comes from a data set, not from a job."
        return section("Limits", absent(words))
    return section(
        "Limits",
        table(("", "this result", "limit", ""), judged, "lrrl"),
        note(_policy(source, limits) + _odds(source)),
    )


def limit_rows(source: LaserSource) -> list[Row]:
    """Every figure that the job sets a limit to, with that limit."""
    limits = dig(source.run, "job_config")
    rows = _reference_rows(source, limits) if source.is_reference else _check_rows(source, limits)
    return [row for row in rows if number(row[2]) is not None]


def _check_rows(source: LaserSource, limits: Any) -> list[Row]:
    rows: list[Row] = []
    if source.measured is None:
        return rows
    answer, update = source.measured.result, source.measured.inputs.update
    for key, apart, words in (
        ("against_reference", answer.against_reference, "the reference"),
        ("against_last", answer.against_last, "the frame in effect"),
    ):
        if apart is not None:
            bent = f"off {words}, to count as bent"
            rows.append((f"point {bent}", apart.shift, dig(limits, key, "max_shift_m"), mm))
            rows.append((f"axis {bent}", apart.tilt_rad, dig(limits, key, "max_tilt_rad"), deg))
    if (test := answer.moved) is not None:
        words = "off the frame in effect, to count as moved"
        rows.append((f"point {words}", test.shift_m, test.tolerance_m, mm))
        rows.append((f"axis {words}", test.tilt_rad, test.tolerance_rad, deg))
    rows.append(("uncertainty U of the point", source.U, dig(limits, "max_U_m"), mm))
    if limits is not None and update is not None and (second := update.second_scan) is not None:
        rows.append(("point off the reference, tried", second.apart, second.U_m, mm))
    return rows


def _odds(source: LaserSource) -> str:
    """What a test of two results misses, and how often it calls a good tool wrong."""
    if source.measured is None:
        return ""
    update = source.measured.inputs.update
    test = source.measured.result.moved or (update.second_scan if update is not None else None)
    told = odds_of(test)
    return f" {told[0].upper()}{told[1:]}." if told else ""


def _reference_rows(source: LaserSource, limits: Any) -> list[Row]:
    slope = max(source.slopes.values(), default=None)
    return [
        ("height between the beams", source.plane_gap, dig(limits, "max_plane_gap_m"), mm),
        ("slope of a beam against base x-y", slope, dig(limits, "max_slope_rad"), deg),
        ("uncertainty U of the point", source.U, dig(limits, "max_U_m"), mm),
    ]


def _judged(name: str, value: Any, limit: Any, shown: Callable[[Any], str]) -> tuple[str, str, str, str]:
    plain, most = number(value), number(limit)
    if plain is None or most is None:
        return name, DASH, shown(limit), DASH
    return name, shown(plain), shown(most), "within" if plain <= most else "beyond"


def _policy(source: LaserSource, limits: Any) -> str:
    if dig(limits, "accept") is None:
        return "A check measures and proposes nothing."
    auto = "by policy when it passes" if dig(limits, "accept", "auto") else "by an operator"
    if source.is_reference:
        return f"A reference is a proposal until it is accepted {auto}."
    return (
        f"A new tool frame is accepted {auto}, tried in a second scan, and put into effect only when its "
        "point meets the reference within the limit. Beyond a shift or tilt limit the tool counts as bent: "
        "nothing is corrected."
    )
