"""The report of a test of pose accuracy and repeatability, in the manner of ISO 9283."""

from procedures.iso9283.record import DATA_FILE
from procedures.iso9283.report.plots import arrivals_section, deviation_section, drift_section
from procedures.iso9283.report.source import IsoSource
from procedures.report.html import Html, absent, bullets, el, facts, note, section, table
from procedures.report.layout import Layout, Page
from procedures.report.numbers import DASH, dig, mm, mms, number
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
    if source.answer is None:
        return top
    tracker = dig(source.answer, "tracker")
    return Html(
        top
        + cards(
            (
                (mm(dig(source.answer, "AP_max")), "AP of the worst pose; never below the tracker's own"),
                (mm(dig(source.answer, "RP_max")), "RP of the worst pose; never below the tracker's own"),
                (mm(dig(tracker, "AP_95_m")), "AP that the tracker alone may read of a perfect arm (95 %)"),
                (mm(dig(tracker, "RP_m")), "RP that the tracker alone reads of a perfect arm"),
            )
        )
    )


def figures_section(source: IsoSource) -> Html | None:
    """AP and RP pose by pose, each beside the tracker's, with the formulas."""
    if source.answer is None:
        return None
    title = "Accuracy and repeatability"
    if not source.poses:
        return section(title, absent("The result has no poses."))
    head = ("pose", "AP", "measured", "± 95 %", "tracker", "RP", "measured", "95 % interval", "tracker", "n")
    rows = []
    for pose in source.poses:
        rows.append(
            [
                el("b", pose.get("name")),
                _figure(pose, "AP"),
                mm(pose.get("AP_measured")),
                mm(pose.get("AP_U")),
                mm(pose.get("AP_tracker")),
                _figure(pose, "RP"),
                mm(pose.get("RP_measured")),
                _interval(pose.get("RP_95")),
                mm(pose.get("RP_tracker")),
                pose.get("cycles"),
            ]
        )
    formula = dig(source.answer, "formula")
    return section(
        title,
        table(head, rows, "lrrrrrrrrr"),
        *(note(el("code", dig(formula, key))) for key in ("AP", "RP")),
        note(
            "'tracker' is what a perfect arm would read, from the stated noise at the range of the pose; "
            "averaging is given no credit. A figure with ≤ was measured below that, so the tracker's own "
            "stands in its place."
        ),
    )


def _figure(pose: object, key: str) -> Html:
    shown = mm(dig(pose, key))
    return el("b", shown if dig(pose, f"{key}_resolved") else f"≤ {shown}")


def _interval(value: object) -> str:
    if not isinstance(value, list) or len(value) != 2:
        return DASH
    low, high = mms([float(v) for v in value])
    return f"{low} … {high}"


def conditions_section(source: IsoSource) -> Html | None:
    """What it holds for: kinematics, speed, payload, cycles, and how the tracker was placed."""
    if source.answer is None:
        return None
    answer, place = source.answer, dig(source.answer, "registration")
    version = dig(answer, "kinematics_version")
    corrected = bool(dig(answer, "corrected"))
    fitted = dig(place, "how") == "fit"
    rows: list[tuple[str, object, str]] = [
        (
            "Commanded",
            "through the calibrated kinematics" if corrected else "by the controller's own model",
            f"Version {version} of the kinematics." if corrected and version is not None else "",
        ),
        (
            "Cycles",
            f"{dig(answer, 'cycles')} of {dig(answer, 'cycles_wanted')}",
            "Every pose is always reached from the same one; the standard has 30.",
        ),
        (
            "Speed and payload",
            f"{100 * (number(dig(answer, 'speed_share')) or 0):g} %, {dig(answer, 'payload_kg')} kg",
            "Share of the cell's limits, which may be lower than the arm's own; the figures hold for these.",
        ),
        (
            "The tracker's place",
            "fitted to these poses" if fitted else "from the calibration",
            f"The barycentres are {mm(dig(place, 'rms_m'))} off in it (RMS), "
            f"{mm(dig(place, 'rms_best_m'))} in the place that suits them best.",
        ),
    ]
    open_ = dig(source.result, "observability", "undetermined") or []
    return section(
        "What it holds for",
        facts(rows),
        el("h3", "Not measured"),
        bullets(open_),
    )


def _page(_source: IsoSource) -> Page[IsoSource]:
    return Page(
        top=(verdict_section, figures_section),
        left=(deviation_section,),
        right=(conditions_section,),
        rest=(arrivals_section, drift_section, trend_section, timeline_section, inputs_section),
    )


def _title(source: IsoSource) -> str:
    if source.answer is None:
        return "Pose accuracy and repeatability"
    how = "corrected" if dig(source.answer, "corrected") else "uncorrected"
    return f"Pose accuracy and repeatability, {how}"


ISO9283 = Layout(source=IsoSource, data_file=DATA_FILE, title=_title, page=_page)
