"""The first page of a kinematic calibration's report: the verdict, and three figures on held-out poses."""

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.report.html import Html, absent, el, facts, note, section, table
from procedures.report.numbers import DASH, degs, mm, mms
from procedures.report.verdict import banner, cards
from procedures.tracker.report.source import KincalSource
from procedures.tracker.result import NoiseInUse

_NOMINAL = "The nominal arm, in the place of the tracker that was found."
_REGISTERED = (
    "The nominal arm, in the place of the tracker that suits it best: what registration gives alone."
)
_CALIBRATED = "The calibrated arm, each time without these poses."
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
    found = source.found
    if found is None:
        return top
    before, after = found.result.rms_registration_only, found.result.rms_calibrated
    gain = DASH if not before or not after else f"{before / after:.{0 if before > 10.0 * after else 1}f} ×"
    predicted = found.uncertainty.predicted_95
    worst = None if predicted is None else predicted.workspace.max
    places = 0 if predicted is None else len(predicted.workspace.places)
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
                    mm(worst),
                    "95 % of prediction errors through noise of the readings stay below this at the worst of "
                    f"{places} places; what the arm's model lacks is not in it",
                ),
            )
        )
    )


def figures_section(source: KincalSource) -> Html | None:
    """Nominal, registration only and calibrated, with the tracker's uncertainty beside each."""
    found = source.found
    if found is None:
        return None
    title, held, answer = "Held-out check", found.heldout, found.result
    if not held.samples:
        return section(title, absent("There were too few samples to hold any back."))
    noise = found.uncertainty.tracker
    axis = mm(None if noise is None else noise.sigma_axis)
    range_m = DASH if noise is None else f"{noise.range_m:.2f} m"
    tracker, whose = mm(source.tracker_3d), source.whose_noise
    rows = [
        (el("b", "nominal"), mm(answer.rms_nominal), mm(held.max.nominal), axis, tracker),
        (
            el("b", "registration only"),
            mm(answer.rms_registration_only),
            mm(held.max.registration_only),
            axis,
            tracker,
        ),
        (el("b", "calibrated"), mm(answer.rms_calibrated), mm(held.max.calibrated), axis, tracker),
    ]
    return section(
        title,
        table(
            ("distance from the tracker's readings", "RMS", "largest", f"{whose}, 1σ", f"{whose}, √3 σ"),
            rows,
            "lrrrr",
        ),
        note(el("b", "nominal"), ": ", _NOMINAL),
        note(el("b", "registration only"), ": ", _REGISTERED),
        note(el("b", "calibrated"), ": ", _CALIBRATED),
        note(
            f"{held.samples} of {found.inputs.used} samples in {held.folds} folds, "
            "each judged by an arm that did not see it. "
            "The distances hold the tracker's own noise: √3 σ of single readings, less where a point "
            "averages many. σ is along one axis, "
            f"at the middle range of {range_m}; {_noise(answer.noise)}."
        ),
    )


def _noise(noise: NoiseInUse) -> str:
    how = (
        "as stated for the instrument"
        if noise.given
        else "estimated from the residuals: the tracker's noise, which is not given, and what the model lacks"
    )
    return f"{1e6 * noise.sigma0:.1f} µm + {1e6 * noise.sigma_per_m:.1f} µm per metre, {how}"


def place_section(source: KincalSource) -> Html | None:
    """Where the tracker stands, and what the samples were measured with."""
    T = source.T_base_tracker
    if source.found is None or T is None:
        return None
    answer = source.found.result
    turned = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    rows: list[tuple[str, object, str]] = []
    payload = answer.payload_kg
    rows.append(
        (
            "Payload",
            "not stated" if payload is None else f"{payload:.3g} kg",
            "The arm bends under it: the calibration holds for this payload.",
        )
    )
    if (excess := answer.noise.excess) > 1.0:
        rows.append(
            (
                "Residuals over noise",
                f"{np.sqrt(excess):.2f} ×",
                "Errors that the parameters lack, as gears and bending; the uncertainties are widened by it.",
            )
        )
    if (classic := answer.classic) is not None:
        rows.append(
            (
                "Classic method",
                f"{classic.iterations} steps",
                f"Stopped by {classic.stopped}; it gives no uncertainty.",
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
