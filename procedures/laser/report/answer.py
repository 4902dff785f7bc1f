"""The first page of a crossed-beam report: the verdict, the answer with its uncertainty, and its limits."""

import numpy as np

from procedures.laser.judging import BENT, NOT_CONFIRMED
from procedures.laser.moved_words import NAME as MOVED
from procedures.laser.moved_words import axis_words, point_words
from procedures.laser.report.checks import ms
from procedures.laser.report.source import LaserSource
from procedures.laser.result import MovedTest
from procedures.report.html import Html, absent, el, note, paragraph, section, table
from procedures.report.numbers import DASH, K95, deg, degs, dig, mm, mms
from procedures.report.verdict import banner, cards

_BENT = (
    "Look at the tool: a shift or tilt this large is damage, not drift, and is not corrected. Repair or "
    "change it, then make a new reference with laser-reference."
)
_MOVED = (
    "The beams show another tool than the frame in effect. Look at the tool and at its fixture, then correct "
    "the frame: cellward start laser-update{}."
)
_NOT_CONFIRMED = (
    "Nothing was changed. Where the tool's point missed the reference, see that tool, beams and fixture are "
    "tight; else correct what the reason names. Then start laser-update again."
)
_REMEDY = {
    BENT: _BENT,
    "bent-tool": _BENT,
    NOT_CONFIRMED: _NOT_CONFIRMED,
    "no-edges": "Check that the tool crosses the beams below its point, and that their inputs switch.",
    "one-beam-only": "Check the other beam and its input: it never showed the tool.",
    "too-few-passes": "Take more passes; the reasons below say why these could not be used.",
    "beam-along-tool": "Check R_base_flange and the beams' directions: a beam must cross the tool.",
    "beams-parallel": "Check the beams' directions: they must cross each other.",
}
_OTHERWISE = "Correct what the reason names, and measure again."


def verdict_section(source: LaserSource) -> Html:
    """The verdict, why, and four figures to take away."""
    tool = dig(source.run, "values", "tool", "name")  # of several, another one may be the usual one
    moved = _MOVED.format(f" -p tool={tool}" if tool else "")
    top = banner(source, {MOVED: moved, **_REMEDY}, _OTHERWISE, _became(source))
    if source.found is None:
        return top
    return Html(top + (_reference_cards(source) if source.is_reference else _cards(source)))


def _became(source: LaserSource) -> Html | None:
    """What an update came to; it is not the same as its verdict."""
    if source.measured is None:
        return None
    if (test := source.measured.result.moved) is not None:
        return _test_of(test)
    update = source.measured.inputs.update
    if update is None or update.committed is None:
        return None
    if update.committed:
        by = update.accepted_by
        return paragraph(f"The new tool frame is in effect from the next job on, accepted by {by}.")
    return paragraph(f"The new tool frame was not put into effect: {update.why}.")


def _test_of(test: MovedTest) -> Html:
    """The test of a check in a sentence, also when the tool has not moved."""
    found = "has moved" if test.moved else "has not moved"
    words = f"The tool {found} against the frame in effect: its point by {point_words(test)}"
    if axis := axis_words(test):
        words += f", its axis by {axis}"
    return paragraph(f"{words}.")


def _cards(source: LaserSource) -> Html:
    dp, drot = source.dp, source.drot
    return cards(
        (
            (
                DASH if dp is None else mm(float(np.linalg.norm(dp))),
                "distance of the tool's point from where the reference has it",
            ),
            (mm(source.U), "U: 95 % of the errors of that displacement are below this, if the model holds"),
            (
                "not measured" if drot is None else deg(float(np.linalg.norm(drot))),
                "tilt of the tool's axis against the reference",
            ),
            (ms(source.delay), "delay of the beams' signals, from the ways out and back"),
        )
    )


def _reference_cards(source: LaserSource) -> Html:
    passes = None if source.made is None else source.made.result.passes
    return cards(
        (
            (mm(source.U), "U: 95 % of the errors of the tool's point in the beams are below this"),
            (mm(source.plane_gap), "height between the two beams where they cross"),
            (ms(source.delay), "delay of the beams' signals, from the ways out and back"),
            (DASH if passes is None else str(len(passes)), "ways across the beams that were used"),
        )
    )


def result_section(source: LaserSource) -> Html:
    """The displacement and the tilt with their 95 % intervals; of a reference its beams."""
    if source.is_reference:
        return _beams_section(source)
    title = "The result: the tool's point in the flange"
    dp, drot, cov = source.dp, source.drot, source.cov
    if dp is None or source.measured is None:
        return section(title, absent("There is no answer, so there is nothing to show."))
    sigma = None if cov is None else np.sqrt(np.maximum(np.diag(cov), 0.0))
    rows: list[list[object]] = [["moved by, mm", *mms(dp)]]
    if sigma is not None:
        rows.append(["± 95 %, mm", *mms(K95 * sigma[:3])])
    if drot is not None:
        rows.append(["axis turned by, °", *degs(drot)])
        if sigma is not None:
            rows.append(["± 95 %, °", *degs(K95 * sigma[3:])])
    rows.append(["flange at the beams moved in base, mm", *mms(source.measured.result.flange_offset_base)])
    return section(
        title,
        table((el("code", "dp_flange"), "x", "y", "z"), rows, "lrrr"),
        note(
            "What the tool's point and axis are now, less what the reference has, along the axes of the "
            "flange. The intervals come from the covariance (1.96 standard deviations); they hold if the arm "
            "repeats, the beams stand still, and polls and poses share one clock."
        ),
    )


def _beams_section(source: LaserSource) -> Html:
    """Where the beams are, and where the flange was when the tool's point met them."""
    title = "The result: the beams in the base"
    if source.made is None or not source.beams:
        return section(title, absent("There is no answer, so there is nothing to show."))
    rows: list[list[object]] = []
    for name, beam in source.beams.items():
        rows.append([f"beam {name} through, mm", *mms(beam.point)])
        rows.append(["along", *(f"{v:.6f}".replace("-", "\N{MINUS SIGN}") for v in beam.direction)])
        if (hit := source.made.result.hits.get(name)) is not None:
            rows.append(["flange when the point meets it, mm", *mms(hit)])
    return section(
        title,
        table(("", "x", "y", "z"), rows, "lrrr"),
        note(
            "Found by crossing each beam at two places. The height of a beam is where the tool's point first "
            "meets it, so an error of the tool's length moves both; later checks are held against the hits "
            "and are free of it."
        ),
    )
