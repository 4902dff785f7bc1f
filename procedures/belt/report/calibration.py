"""The report of a belt calibration: scale and direction, and every sighting beside the motion found."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from cell.poses import Array
from procedures.belt.calibrating.record import DATA_FILE
from procedures.belt.report.cover import calibration_cover
from procedures.belt.result import BeltCalibrationResult
from procedures.report.figure import PALETTE, REJECTED, dots, dressed, embed, figure, polyline
from procedures.report.html import Html, absent, bullets, facts, note, section
from procedures.report.layout import Layout, Page
from procedures.report.numbers import DASH, dig, mm
from procedures.report.origin import inputs_section
from procedures.report.source import Source
from procedures.report.timeline import timeline_section
from procedures.report.trend import trend_section
from procedures.report.verdict import banner, cards

_REMEDY = {
    "belt-stands": "Start the belt, and look whether the encoder's wheel turns with it.",
    "encoder-stands": "Repair the coupling of the encoder to the belt.",
    "no-travel": "Let the items be carried further while they are seen.",
    "too-few-sightings": "Put items on the belt that the camera sees wholly, and look at [job.*] items.",
    "max_heldout_m": "Look for slip of the encoder's wheel, and for items that roll or slide.",
}
_AXES = ("along the belt", "across it", "up")


@dataclass
class CalibrationSource(Source[BeltCalibrationResult]):
    """A result of kind ``belt-calibration``."""

    def sightings(self) -> "Sightings | None":
        """Every sighting or touch; None where the result lists none."""
        rows = None if self.found is None else self.found.residuals.per_sighting
        if not rows:
            return None
        return Sightings(
            np.array([row.count for row in rows], dtype=float),
            np.array([row.off_m for row in rows], dtype=float).reshape(-1, 3),
            np.array([row.item for row in rows]),
            np.array([row.used for row in rows]),
        )


@dataclass(frozen=True)
class Sightings:
    """``off`` (k, 3) m beside the motion found: along, across and up; which ``item`` and whether ``used``."""

    count: Array
    off: Array
    item: Array
    used: Array


def verdict_section(source: CalibrationSource) -> Html:
    """The verdict, why, and five figures to take away."""
    top = banner(source, _REMEDY, "Correct what the reason names, and calibrate again.")
    found = source.found
    if found is None:
        return top
    m, half = found.result.m_per_count, found.uncertainty.half_m_per_count
    share = DASH if not m or half is None else f"{100 * half / abs(m):.3f} %"
    level, rise = found.direction_95_rad()
    return Html(
        top
        + cards(
            (
                (_micron(m), "of the belt's travel for one count"),
                (f"± {share}", "95 % interval of it"),
                (f"± {_mrad(level)}", "95 % interval of the direction, seen from above"),
                (f"± {_mrad(rise)}", "95 % interval of how it rises"),
                (mm(found.heldout.rms_m), "RMS of sightings that were set aside"),
            )
        )
    )


def result_section(source: CalibrationSource) -> Html | None:
    """Scale and direction, beside the configured belt."""
    found = source.found
    if found is None:
        return None
    answer, way = found.result, [*found.result.dir, 0.0][:3]
    low_high = answer.m_per_count_95
    interval = DASH if low_high is None else " … ".join(_micron(v) for v in low_high)
    rows: list[tuple[str, object, str]] = [
        ("One count", _micron(answer.m_per_count), f"95 %: {interval}; negative: the counter falls."),
        (
            "Direction",
            ", ".join(f"{v:.5f}" for v in way),
            f"The way the belt ran, in the base: {np.degrees(np.arctan2(way[1], way[0])):.3f}° from x "
            f"towards y, rising by {np.degrees(np.arcsin(np.clip(way[2], -1, 1))):.3f}°.",
        ),
        ("Longest way of an item", mm(answer.travel_m), "The longer, the surer is the scale."),
        (
            "Sightings",
            f"{answer.sightings} of {answer.items} items",
            f"They scatter by {mm(found.residuals.sigma_m)} along each axis.",
        ),
    ]
    configured = dig(source.run, "values", "configured", f"belt.{found.inputs.device}")
    if configured is not None:
        rows.append(
            ("Configured", _micron(dig(configured, "m_per_count")), f"Direction {dig(configured, 'dir')}.")
        )
    return section("Scale and direction", facts(rows), bullets(found.observability.undetermined))


def ways_section(source: CalibrationSource) -> Html | None:
    """The way of each item over the counts: one slope for all."""
    found, seen = source.found, source.sightings()
    if found is None:
        return None
    if seen is None:
        return section("Sightings against counts", absent("The result lists no sightings."))
    m = found.result.m_per_count
    fig = figure(360, showlegend=False)
    begin = float(seen.count.min())
    for k, i in enumerate(np.unique(seen.item)):
        own = (seen.item == i) & seen.used
        x = seen.count[own]
        if not len(x):
            continue
        y = 1e3 * (m * (x - x[0]) + np.sign(m) * seen.off[own, 0])
        tint = PALETTE[k % len(PALETTE)]
        fig.add_trace(_dots(x - begin, y, tint, f"item {int(i)}"))
        fig.add_trace(polyline([x[0] - begin, x[-1] - begin], [0.0, 1e3 * m * (x[-1] - x[0])], tint))
    fig.update_xaxes(title_text="counts since the first sighting")
    fig.update_yaxes(title_text="way since its first sighting, mm")
    return section(
        "Sightings against counts",
        embed(fig, "ways"),
        note("Each item from where it was first seen. The lines have the one slope that was found for all."),
    )


def residuals_section(source: CalibrationSource) -> Html | None:
    """What is left of each sighting, along, across and up."""
    seen = source.sightings()
    if seen is None:
        return None
    fig = make_subplots(1, 3, subplot_titles=_AXES, horizontal_spacing=0.07)
    dressed(fig, 300, showlegend=False)
    begin = float(seen.count.min())
    for axis in range(3):
        for k, i in enumerate(np.unique(seen.item)):
            own = (seen.item == i) & seen.used
            y = 1e3 * seen.off[own, axis]
            fig.add_trace(
                _dots(seen.count[own] - begin, y, PALETTE[k % len(PALETTE)], f"item {int(i)}"), 1, axis + 1
            )
        left = np.logical_not(seen.used)
        if left.any():
            crosses = _dots(seen.count[left] - begin, 1e3 * seen.off[left, axis], REJECTED, "left out")
            crosses.marker.symbol = "x"
            fig.add_trace(crosses, 1, axis + 1)
        fig.update_xaxes(title_text="counts", row=1, col=axis + 1)
    fig.update_yaxes(title_text="mm", row=1, col=1)
    return section(
        "What is left of each sighting",
        embed(fig, "residuals"),
        note(
            "Beside the motion of its own item. Scatter is the camera's; a bend or a step along the belt is "
            "the encoder's (slip, an eccentric wheel); a slope towards the picture's edges is the lens. "
            "Crosses were left out."
        ),
    )


def _dots(x: Array, y: Array, tint: str, name: str) -> Any:
    return dots(x, y, tint, f"{name}, %{{x:.0f}} counts: %{{y:.3f}} mm", size=5, name=name)


def _micron(value: float) -> str:
    return f"{1e6 * value:.3f} µm"


def _mrad(value: float | None) -> str:
    return DASH if value is None else f"{1e3 * value:.2f} mrad"


def _page(_source: CalibrationSource) -> Page[CalibrationSource]:
    return Page(
        top=(verdict_section,),
        left=(ways_section,),
        right=(result_section,),
        rest=(residuals_section, trend_section, timeline_section, inputs_section),
    )


BELT_CALIBRATION = Layout(
    source=CalibrationSource,
    data_file=DATA_FILE,
    title=lambda _source: "Belt calibration",
    page=_page,
    cover=calibration_cover,
)
