"""What only a run has: monuments and drift, poses set aside before solving, limits, and what was promised."""

from collections.abc import Mapping
from typing import Any

import plotly.graph_objects as go

from procedures.report.figure import PALETTE, SOFT, embed, figure, label
from procedures.report.html import Html, absent, facts, note, paragraph, section, table
from procedures.report.numbers import DASH, dig, mm, number
from procedures.tracker.report.source import KincalSource
from procedures.tracker.result import Monuments

_NOISE_95 = 2.795  # of a 3D normal vector's length, in units of its sigma


def monuments_section(source: KincalSource) -> Html | None:
    """How far each monument was from where the first look saw it; None for a data set."""
    sampling = source.sampling
    if sampling is None:
        return None
    title, found = "Did the tracker stand still?", sampling.monuments
    if found is None:
        return section(title, absent("No monument was looked at, so nothing says that the stand stood."))
    if not found.looks:
        return section(
            title, absent(f"{', '.join(found.names)} were looked at once: nothing to compare with.")
        )
    moved = "more than noise explains" if found.beyond_noise else "within noise"
    return section(
        title,
        embed(_figure(found), "monuments"),
        paragraph(
            "Farthest that a monument is from where the first look saw it: "
            f"{mm(found.max_moved_m)}, {moved}; the limit is {mm(found.limit_m)}."
        ),
        note(
            "Monuments are reflectors fixed to the base or the floor. The dotted line is the length that "
            "95 % of distances from noise alone stay below. "
            f"{found.samples_since_last_look or 'No'} poses were measured after the last look."
        ),
    )


def _figure(found: Monuments) -> Any:
    fig = figure(280)
    at = [look.after for look in found.looks]
    for k, name in enumerate(found.names):
        off = [look.moved[name].moved_m if name in look.moved else None for look in found.looks]
        fig.add_trace(
            go.Scatter(
                x=at,
                y=[None if v is None else 1e3 * v for v in off],
                mode="lines+markers",
                line={"color": PALETTE[k % len(PALETTE)], "width": 1.4},
                name=label(name),
                hovertemplate="after %{x} poses: %{y:.4f} mm<extra></extra>",
            )
        )
    sigmas = [moved.sigma_m for look in found.looks for moved in look.moved.values()]
    noise = _NOISE_95 * max(sigmas, default=0.0)
    fig.add_hline(y=1e3 * noise, line={"color": SOFT, "dash": "dot", "width": 1.4})
    fig.add_hline(y=1e3 * found.limit_m, line={"color": SOFT, "dash": "dash", "width": 1.4})
    fig.update_xaxes(title_text="poses measured")
    fig.update_yaxes(title_text="distance, mm", rangemode="tozero")
    return fig


def aside_section(source: KincalSource) -> Html | None:
    """Poses that were set aside before anything was solved; None when there are none."""
    found = None if source.found is None else source.found.heldout.set_aside
    if found is None:
        return None
    rms, most, tracker = found.rms, found.max, mm(found.tracker_3d)
    rows = [
        ("nominal", mm(rms.nominal), mm(most.nominal), tracker),
        ("registration only", mm(rms.registration_only), mm(most.registration_only), tracker),
        ("calibrated", mm(rms.calibrated), mm(most.calibrated), tracker),
    ]
    return section(
        "Poses set aside before solving",
        table(("distance from the tracker's readings", "RMS", "largest", "tracker, √3 σ"), rows, "lrrr"),
        note(
            f"{found.samples} poses taken at random, never solved with: they judge the very arm that "
            "is exported. The tracker's own noise is in the distances."
        ),
    )


def limits_section(source: KincalSource) -> Html | None:
    """The limits of the job and what the plan promised; None for a data set."""
    limits, sampling = dig(source.run, "job_config"), source.sampling
    if source.found is None or not isinstance(limits, Mapping):
        return None
    forecast = source.found.uncertainty.predicted_95
    predicted = None if forecast is None else forecast.workspace.max
    limit = number(dig(limits, "accept", "max_error_m"))
    judged = DASH if predicted is None or limit is None else "within" if predicted <= limit else "beyond"
    rows: list[tuple[str, object, str]] = [
        (
            "Predicted error, worst place",
            f"{mm(predicted)} of {mm(limit)}",
            f"{judged}: 95 % of prediction errors anywhere in the joint ranges of the samples.",
        )
    ]
    plan = None if sampling is None else sampling.predicted
    promised = number(dig(plan, "error_95_max_m"))
    if promised is not None:
        random, rms = number(dig(plan, "random_rms_m")), number(dig(plan, "rms_m"))
        more = "" if not random or not rms else f" ({rms / random:.2f} of what random poses promise, RMS)"
        rows.append(("Promised by the plan", mm(promised), f"The same, before anything moved{more}."))
    if sampling is not None:
        rows.append(
            ("Poses", f"{sampling.measured} of {sampling.wanted}", "Measured, of those that were wanted.")
        )
    return section("Limits", facts(rows))
