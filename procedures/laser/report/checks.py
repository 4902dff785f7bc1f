"""Single figures of a crossed-beam measurement, its held-out check, and what it leaves open."""

from typing import Any

import numpy as np

from procedures.laser.report.source import LaserSource, vector
from procedures.report.html import Html, absent, bullets, el, facts, note, section, table
from procedures.report.numbers import DASH, K95, deg, dig, mm, number

_MOST_ROWS = 30
_SETS = {"current": "now", "reference": "reference"}


def ms(seconds: Any) -> str:
    """Seconds as milliseconds."""
    plain = number(seconds)
    return DASH if plain is None else f"{1e3 * plain:.2f} ms"


def figures_section(source: LaserSource) -> Html | None:
    """Uncertainty by direction, delay, hysteresis and noise, each with what it means."""
    if source.answer is None:
        return None
    found = source.result.get("uncertainty")
    rows: list[tuple[str, object, str]] = []
    for key, name, shown, meaning in (
        ("U_xy_m", "U across the tool", mm, "95 % of the errors across the tool's axis are below this."),
        ("U_z_m", "U along the tool", mm, "95 % of the errors along it: from the search in height."),
        ("U_tilt_rad", "U of the tilt", deg, "95 % of the errors of the tilt: from the two heights."),
        ("U_gap_m", "U of the height between the beams", mm, "95 % of the errors of that height."),
        ("noise_m", "Noise", mm, "Scatter of the edges beside the intervals between polls, one sigma."),
    ):
        value = number(dig(found, key)) or number(dig(source.answer, "plane", key))
        if value is not None:
            rows.append((name, shown(value), meaning))
    if (turn := vector(dig(source.answer, "axis_turn_flange"))) is not None:
        meaning = "How the axis of this tool stands against the one that was configured."
        rows.append(("Axis of the tool", deg(float(np.linalg.norm(turn))), meaning))
    if source.delay is not None:
        meaning = "From the break of a beam to the stamp of its poll; half of what out and back disagree by."
        rows.append(("Delay of the signals", _pm(ms, source.delay, dig(found, "sigma_tau_s")), meaning))
    hysteresis = number(dig(source.answer, "hysteresis_m"))
    if hysteresis is not None:
        meaning = "A shift along the way that does not depend on the speed; passes of two speeds show it."
        rows.append(("Hysteresis", _pm(mm, hysteresis, dig(found, "sigma_hysteresis_m")), meaning))
    return section("In figures", facts(rows)) if rows else None


def _pm(shown: Any, value: Any, sigma: Any) -> str:
    plain = number(sigma)
    return shown(value) if plain is None else f"{shown(value)} ± {shown(K95 * plain)} (95 %)"


def held_out_section(source: LaserSource) -> Html | None:
    """Edges judged by solutions that did not see their pass."""
    if source.answer is None or source.is_reference:
        return None
    held = source.result.get("heldout")
    title = "Held-out check"
    if number(dig(held, "rms_m")) is None:
        return section(title, absent("The result has no held-out check."))
    row = (
        "Held out, RMS",
        mm(dig(held, "rms_m")),
        f"{dig(held, 'edges')} edges of {dig(held, 'passes')} passes, each against a solution without its "
        f"pair of passes. A perfect solution would have {mm(dig(held, 'expected_m'))}, as an edge may be "
        "anywhere between two polls.",
    )
    return section(title, facts([row]))


def open_section(source: LaserSource) -> Html:
    """What was not determined, and the passes that were left out."""
    found = source.result.get("observability")
    lines: list[object] = [f"Not determined: {words}." for words in dig(found, "undetermined") or []]
    if source.answer is not None:
        lines.append(
            "Not tested by these data: whether the beams still stand where the reference found them. A "
            "fixture that was moved looks like a tool that was bent."
        )
    body = bullets(lines) if lines else absent("The result says nothing of what the data leave open.")
    return section("What the data could not determine", body, _rejected(source))


def _rejected(source: LaserSource) -> Html | None:
    """One row for the passes of a beam that were left out for the same reason."""
    listed = dig(source.answer, "rejected")
    if listed is None:
        listed = dig(source.result, "residuals", "rejected")
    grouped: dict[tuple[str, str, str], list[int]] = {}
    for entry in listed if isinstance(listed, list) else []:
        why = str(dig(entry, "reason")).split(":")[0]
        key = (_SETS.get(str(dig(entry, "set")), "reference"), str(dig(entry, "beam")), why)
        grouped.setdefault(key, []).append(int(number(dig(entry, "index")) or 0))
    if not grouped:
        return None
    rows = [(where, beam, str(len(own)), _ranges(own), why) for (where, beam, why), own in grouped.items()]
    more = len(rows) - _MOST_ROWS
    return Html(
        el("h3", "Passes that were not used across the beams")
        + table(("set", "beam", "passes", "numbers", "why"), rows[:_MOST_ROWS], "llr")
        + (note(f"{more} more rows are in result.json.") if more > 0 else "")
    )


def _ranges(numbers: list[int]) -> str:
    """``8-10, 42`` of 8, 9, 10, 42."""
    runs: list[list[int]] = []
    for n in sorted(numbers):
        if runs and n == runs[-1][-1] + 1:
            runs[-1].append(n)
        else:
            runs.append([n])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}\N{EN DASH}{run[-1]}" for run in runs)
