"""The first page of a kinematic calibration's report: the verdict, and three figures on held-out poses."""

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.report.html import Html, absent, el, facts, note, section, table
from procedures.report.numbers import DASH, degs, dig, mm, mms, number
from procedures.report.verdict import banner, cards
from procedures.tracker.report.source import KincalSource

_FIGURES = (
    ("nominal", "rms_nominal", "nominal", "The nominal arm, in the place of the tracker that was found."),
    (
        "registration_only",
        "rms_registration_only",
        "registration only",
        "The nominal arm, in the place of the tracker that suits it best: what registration gives alone.",
    ),
    ("calibrated", "rms_calibrated", "calibrated", "The calibrated arm, each time without these poses."),
)
_REMEDY = {
    "too-few-poses": "Measure more poses: every pose gives three numbers, and none of them twice.",
    "poses-not-distinct": "Measure at joints that differ; the same pose again tells nothing of the arm.",
    "joint-still": "Move every joint: one that stands still cannot be told from the rest of the arm.",
    "unobservable": "Move every joint independently of the others; let the job choose the poses.",
}
_OTHERWISE = "Correct what the reason names, measure again, and let the job choose the poses."


def verdict_section(source: KincalSource) -> Html:
    """The verdict, why, and four figures to take away."""
    top = banner(source, _REMEDY, _OTHERWISE)
    if source.answer is None:
        return top
    before = number(dig(source.answer, "rms_registration_only"))
    after = number(dig(source.answer, "rms_calibrated"))
    gain = DASH if not before or not after else f"{before / after:.{0 if before > 10.0 * after else 1}f} ×"
    predicted = dig(source.result, "uncertainty", "predicted_95", "workspace")
    places = len(dig(predicted, "places") or [])
    return Html(
        top
        + cards(
            (
                (
                    mm(after),
                    f"held-out error, calibrated (RMS); √3 σ of the {source.whose_noise} is "
                    f"{mm(source.tracker_3d)}",
                ),
                (mm(before), "held-out error of the nominal arm in the place that suits it best (RMS)"),
                (gain, "better than the nominal arm, on poses that the solution did not see"),
                (
                    mm(dig(predicted, "max")),
                    "95 % of prediction errors through noise of the readings stay below this at the worst of "
                    f"{places} places; what the arm's model lacks is not in it",
                ),
            )
        )
    )


def figures_section(source: KincalSource) -> Html | None:
    """Nominal, registration only and calibrated, with the tracker's uncertainty beside each."""
    if source.answer is None:
        return None
    title = "Held-out check"
    axis = mm(dig(source.result, "uncertainty", "tracker", "sigma_axis"))
    tracker, whose = mm(source.tracker_3d), source.whose_noise
    held = source.result.get("heldout")
    rows = [
        (
            el("b", name),
            mm(dig(source.answer, key)),
            mm(dig(held, "max", short)),
            axis,
            tracker,
        )
        for short, key, name, _ in _FIGURES
    ]
    judged = number(dig(held, "samples"))
    if not judged:
        return section(title, absent("There were too few samples to hold any back."))
    return section(
        title,
        table(
            ("distance from the tracker's readings", "RMS", "largest", f"{whose}, 1σ", f"{whose}, √3 σ"),
            rows,
            "lrrrr",
        ),
        *(note(el("b", name), ": ", meaning) for _, _, name, meaning in _FIGURES),
        note(
            f"{judged:.0f} of {dig(source.result, 'inputs', 'used')} samples in {dig(held, 'folds')} folds, "
            "each judged by an arm that did not see it. "
            "The distances hold the tracker's own noise: √3 σ of single readings, less where a point "
            "averages many. σ is along one axis, "
            f"at the middle range of {_metres(source)}; {_noise(source)}."
        ),
    )


def _metres(source: KincalSource) -> str:
    found = number(dig(source.result, "uncertainty", "tracker", "range_m"))
    return DASH if found is None else f"{found:.2f} m"


def _noise(source: KincalSource) -> str:
    noise = dig(source.answer, "noise")
    sigma0, slope = number(dig(noise, "sigma0")), number(dig(noise, "sigma_per_m"))
    if sigma0 is None or slope is None:
        return "its size is not stated"
    how = (
        "as stated for the instrument"
        if dig(noise, "given")
        else "estimated from the residuals: the tracker's noise, which is not given, and what the model lacks"
    )
    return f"{1e6 * sigma0:.1f} µm + {1e6 * slope:.1f} µm per metre, {how}"


def place_section(source: KincalSource) -> Html | None:
    """Where the tracker stands, and what the samples were measured with."""
    T = source.T_base_tracker
    if source.answer is None or T is None:
        return None
    turned = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    rows: list[tuple[str, object, str]] = []
    payload = number(dig(source.answer, "payload_kg"))
    rows.append(
        (
            "Payload",
            "not stated" if payload is None else f"{payload:.3g} kg",
            "The arm bends under it: the calibration holds for this payload.",
        )
    )
    excess = number(dig(source.answer, "noise", "excess"))
    if excess is not None and excess > 1.0:
        rows.append(
            (
                "Residuals over noise",
                f"{np.sqrt(excess):.2f} ×",
                "Errors that the parameters lack, as gears and bending; the uncertainties are widened by it.",
            )
        )
    stopped = dig(source.answer, "classic")
    if stopped is not None:
        rows.append(
            (
                "Classic method",
                f"{dig(stopped, 'iterations')} steps",
                f"Stopped by {dig(stopped, 'stopped')}; it gives no uncertainty.",
            )
        )
    return section(
        "The tracker and the arm",
        table(
            ("tracker in base (T_base_tracker)", "x", "y", "z"),
            [["position, mm", *mms(T[:3, 3])], ["rotation vector, °", *degs(turned)]],
            "lrrr",
        ),
        facts(rows),
    )
