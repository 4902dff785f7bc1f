"""Single figures of a crossed-beam measurement, its held-out check, and what it leaves open."""

from collections.abc import Callable, Iterator

import numpy as np

from procedures.laser.report.source import LaserSource
from procedures.laser.result import RejectedPass
from procedures.report.html import Html, absent, bullets, el, facts, note, section, table
from procedures.report.numbers import DASH, K95, deg, mm

_MOST_ROWS = 30


def ms(seconds: float | None) -> str:
    """Seconds as milliseconds."""
    return DASH if seconds is None else f"{1e3 * seconds:.2f} ms"


def figures_section(source: LaserSource) -> Html | None:
    """Uncertainty by direction, delay, hysteresis and noise, each with what it means."""
    found = source.found
    if found is None:
        return None
    rows: list[tuple[str, object, str]] = []
    for name, value, shown, meaning in _sizes(source):
        if value:
            rows.append((name, shown(value), meaning))
    turn = None if source.made is None else source.made.result.axis_turn_flange
    if turn is not None:
        meaning = "How the axis of this tool stands against the one that was configured."
        rows.append(("Axis of the tool", deg(float(np.linalg.norm(turn))), meaning))
    if source.delay is not None:
        meaning = "From the break of a beam to the stamp of its poll; half of what out and back disagree by."
        rows.append(("Delay of the signals", _pm(ms, source.delay, found.uncertainty.sigma_tau_s), meaning))
    if (hysteresis := found.result.hysteresis_m) is not None:
        sigma = None if source.measured is None else source.measured.uncertainty.sigma_hysteresis_m
        meaning = "A shift along the way that does not depend on the speed; passes of two speeds show it."
        rows.append(("Hysteresis", _pm(mm, hysteresis, sigma), meaning))
    return section("In figures", facts(rows)) if rows else None


def _sizes(source: LaserSource) -> Iterator[tuple[str, float | None, Callable[[float], str], str]]:
    noise_m = None if source.found is None else source.found.uncertainty.noise_m
    if source.measured is not None:
        U = source.measured.uncertainty
        yield "U across the tool", U.U_xy_m, mm, "95 % of the errors across the tool's axis are below this."
        yield "U along the tool", U.U_z_m, mm, "95 % of the errors along it: from the search in height."
        yield "U of the tilt", U.U_tilt_rad, deg, "95 % of the errors of the tilt: from the two heights."
    if source.made is not None:
        gap_m = source.made.result.plane.U_gap_m
        yield "U of the height between the beams", gap_m, mm, "95 % of the errors of that height."
    yield "Noise", noise_m, mm, "Scatter of the edges beside the intervals between polls, one sigma."


def _pm(shown: Callable[[float], str], value: float, sigma: float | None) -> str:
    return shown(value) if sigma is None else f"{shown(value)} ± {shown(K95 * sigma)} (95 %)"


def held_out_section(source: LaserSource) -> Html | None:
    """Edges judged by solutions that did not see their pass."""
    if source.measured is None:
        return None
    title, held = "Held-out check", source.measured.heldout
    if held.rms_m is None:
        return section(title, absent("The result has no held-out check."))
    row = (
        "Held out, RMS",
        mm(held.rms_m),
        f"{held.edges} edges of {held.passes} passes, each against a solution without its "
        f"pair of passes. A perfect solution would have {mm(held.expected_m)}, as an edge may be "
        "anywhere between two polls.",
    )
    return section(title, facts([row]))


def open_section(source: LaserSource) -> Html:
    """What was not determined, and the passes that were left out."""
    open_ = source.known("undetermined") if source.found is None else source.found.observability.undetermined
    lines: list[object] = [f"Not determined: {words}." for words in open_ or []]
    if source.found is not None:
        lines.append(
            "Not tested by these data: whether the beams still stand where the reference found them. A "
            "fixture that was moved looks like a tool that was bent."
        )
    body = bullets(lines) if lines else absent("The result says nothing of what the data leave open.")
    return section("What the data could not determine", body, _rejected(source))


def _rejected(source: LaserSource) -> Html | None:
    """One row for the passes of a beam that were left out for the same reason."""
    grouped: dict[tuple[str, str, str], list[int]] = {}
    for entry in source.rejected:
        where = "now" if isinstance(entry, RejectedPass) and entry.set_ == "current" else "reference"
        grouped.setdefault((where, entry.beam, entry.reason.split(":")[0]), []).append(entry.index)
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
