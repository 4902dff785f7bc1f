"""The report of a test of pose accuracy and repeatability, in the manner of ISO 9283."""

from procedures.iso9283.record import DATA_FILE
from procedures.iso9283.report.cover import iso9283_cover
from procedures.iso9283.report.plots import arrivals_section, deviation_section, drift_section
from procedures.iso9283.report.source import IsoSource
from procedures.iso9283.result import Figure, PoseResult
from procedures.report.html import Html, bullets, el, facts, note, section, table
from procedures.report.layout import Layout, Page
from procedures.report.numbers import DASH, mm, mms
from procedures.report.origin import inputs_section
from procedures.report.timeline import timeline_section
from procedures.report.trend import trend_section
from procedures.report.verdict import banner, cards

_REMEDY = {
    "max_AP_m": "Calibrate the arm with tracker-sampling and run the test with corrected = true.",
    "max_RP_m": "Look for play in gears and flange, a loose reflector or stand, and let the arm warm up.",
}


def verdict_section(source: IsoSource) -> Html:
    """The verdict, why, and four figures to take away."""
    top = banner(source, _REMEDY, "Correct what the reason names, and test again.")
    if source.found is None:
        return top
    answer = source.found.result
    return Html(
        top
        + cards(
            (
                (mm(answer.AP_max), "AP of the worst pose; never below the tracker's own"),
                (mm(answer.RP_max), "RP of the worst pose; never below the tracker's own"),
                (mm(answer.tracker.AP_95_m), "AP that the tracker alone may read of a perfect arm (95 %)"),
                (mm(answer.tracker.RP_m), "RP that the tracker alone reads of a perfect arm"),
            )
        )
    )


def figures_section(source: IsoSource) -> Html | None:
    """AP and RP pose by pose, each beside the tracker's, with the formulas."""
    if source.found is None:
        return None
    title, formula = "Accuracy and repeatability", source.found.result.formula
    head = ("pose", "AP", "measured", "± 95 %", "tracker", "RP", "measured", "95 % interval", "tracker", "n")
    rows = []
    for pose in source.poses:
        rows.append(
            [
                el("b", pose.name),
                _figure(pose, "AP"),
                mm(pose.AP_measured),
                mm(pose.AP_U),
                mm(pose.AP_tracker),
                _figure(pose, "RP"),
                mm(pose.RP_measured),
                _interval(pose.RP_95),
                mm(pose.RP_tracker),
                pose.cycles,
            ]
        )
    return section(
        title,
        table(head, rows, "lrrrrrrrrr"),
        note(el("code", formula.AP)),
        note(el("code", formula.RP)),
        note(
            "'tracker' is what a perfect arm would read, from the stated noise at the range of the pose; "
            "averaging is given no credit. A figure with ≤ was measured below that, so the tracker's own "
            "stands in its place."
        ),
    )


def _figure(pose: PoseResult, key: Figure) -> Html:
    value, _, resolved = pose.figure(key)
    return el("b", mm(value) if resolved else f"≤ {mm(value)}")


def _interval(value: list[float] | None) -> str:
    if value is None:
        return DASH
    low, high = mms(value)
    return f"{low} … {high}"


def conditions_section(source: IsoSource) -> Html | None:
    """What it holds for: kinematics, speed, payload, cycles, and how the tracker was placed."""
    if source.found is None:
        return None
    answer = source.found.result
    place, version, corrected = answer.registration, answer.kinematics_version, answer.corrected
    rows: list[tuple[str, object, str]] = [
        (
            "Commanded",
            "through the calibrated kinematics" if corrected else "by the controller's own model",
            f"Version {version} of the kinematics." if corrected and version is not None else "",
        ),
        (
            "Cycles",
            f"{answer.cycles} of {answer.cycles_wanted}",
            "Every pose is always reached from the same one; the standard has 30.",
        ),
        (
            "Speed and payload",
            f"{100 * answer.speed_share:g} %, {answer.payload_kg} kg",
            "Share of the cell's limits, which may be lower than the arm's own; the figures hold for these.",
        ),
        (
            "The tracker's place",
            "fitted to these poses" if place.how == "fit" else "from the calibration",
            f"The barycentres are {mm(place.rms_m)} off in it (RMS), "
            f"{mm(place.rms_best_m)} in the place that suits them best.",
        ),
    ]
    return section(
        "What it holds for",
        facts(rows),
        el("h3", "Not measured"),
        bullets(source.found.observability.undetermined),
    )


def _page(_source: IsoSource) -> Page[IsoSource]:
    return Page(
        top=(verdict_section, figures_section),
        left=(deviation_section,),
        right=(conditions_section,),
        rest=(arrivals_section, drift_section, trend_section, timeline_section, inputs_section),
    )


def _title(source: IsoSource) -> str:
    if source.found is None:
        return "Pose accuracy and repeatability"
    how = "corrected" if source.found.result.corrected else "uncorrected"
    return f"Pose accuracy and repeatability, {how}"


ISO9283 = Layout(source=IsoSource, data_file=DATA_FILE, title=_title, page=_page, cover=iso9283_cover)
