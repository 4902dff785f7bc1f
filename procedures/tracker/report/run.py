"""What only a run has: monuments and drift, poses set aside before solving, limits, and what was promised."""

from collections.abc import Mapping
from typing import Any

import plotly.graph_objects as go

from procedures.report.figure import PALETTE, SOFT, embed, figure, label
from procedures.report.html import Html, absent, facts, note, paragraph, section, table
from procedures.report.numbers import DASH, dig, mm, number
from procedures.tracker.report.source import KincalSource

_NOISE_95 = 2.795  # of a 3D normal vector's length, in units of its sigma


def monuments_section(source: KincalSource) -> Html | None:
    """How far each monument was from where the first look saw it; None for a data set."""
    sampling = source.sampling
    if sampling is None:
        return None
    title = "Did the tracker stand still?"
    found = dig(sampling, "monuments")
    if not isinstance(found, Mapping):
        return section(title, absent("No monument was looked at, so nothing says that the stand stood."))
    names = [str(name) for name in dig(found, "names") or []]
    looks = [look for look in dig(found, "looks") or [] if isinstance(look, Mapping)]
    if not looks:
        return section(title, absent(f"{', '.join(names)} were looked at once: nothing to compare with."))
    moved = "more than noise explains" if dig(found, "beyond_noise") else "within noise"
    return section(
        title,
        embed(_figure(names, looks, number(dig(found, "limit_m"))), "monuments"),
        paragraph(
            "Farthest that a monument is from where the first look saw it: "
            f"{mm(dig(found, 'max_moved_m'))}, {moved}; the limit is {mm(dig(found, 'limit_m'))}."
        ),
        note(
            "Monuments are reflectors fixed to the base or the floor. The dotted line is the length that "
            "95 % of distances from noise alone stay below. "
            f"{dig(found, 'samples_since_last_look') or 'No'} poses were measured after the last look."
        ),
    )


def _figure(names: list[str], looks: list[Mapping[str, Any]], limit: float | None) -> Any:
    fig = figure(280)
    at = [dig(look, "after") for look in looks]
    for k, name in enumerate(names):
        off = [number(dig(look, "moved", name, "moved_m")) for look in looks]
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
    sigmas = [number(dig(look, "moved", name, "sigma_m")) for look in looks for name in names]
    noise = _NOISE_95 * max((s for s in sigmas if s is not None), default=0.0)
    fig.add_hline(y=1e3 * noise, line={"color": SOFT, "dash": "dot", "width": 1.4})
    if limit is not None:
        fig.add_hline(y=1e3 * limit, line={"color": SOFT, "dash": "dash", "width": 1.4})
    fig.update_xaxes(title_text="poses measured")
    fig.update_yaxes(title_text="distance, mm", rangemode="tozero")
    return fig


def aside_section(source: KincalSource) -> Html | None:
    """Poses that were set aside before anything was solved; None when there are none."""
    found = dig(source.result, "heldout", "set_aside")
    if not isinstance(found, Mapping):
        return None
    tracker = mm(dig(found, "tracker_3d"))
    rows = [
        (words, mm(dig(found, "rms", key)), mm(dig(found, "max", key)), tracker)
        for key, words in (
            ("nominal", "nominal"),
            ("registration_only", "registration only"),
            ("calibrated", "calibrated"),
        )
    ]
    return section(
        "Poses set aside before solving",
        table(("distance from the tracker's readings", "RMS", "largest", "tracker, √3 σ"), rows, "lrrr"),
        note(
            f"{dig(found, 'samples')} poses taken at random, never solved with: they judge the very arm that "
            "is exported. The tracker's own noise is in the distances."
        ),
    )


def limits_section(source: KincalSource) -> Html | None:
    """The limits of the job and what the plan promised; None for a data set."""
    limits, sampling = dig(source.run, "job_config"), source.sampling
    if source.answer is None or not isinstance(limits, Mapping):
        return None
    predicted = dig(source.result, "uncertainty", "predicted_95", "workspace", "max")
    limit = dig(limits, "accept", "max_error_m")
    plain, most = number(predicted), number(limit)
    judged = DASH if plain is None or most is None else "within" if plain <= most else "beyond"
    rows: list[tuple[str, object, str]] = [
        (
            "Predicted error, worst place",
            f"{mm(predicted)} of {mm(limit)}",
            f"{judged}: 95 % of prediction errors anywhere in the joint ranges of the samples.",
        )
    ]
    promised = number(dig(sampling, "predicted", "error_95_max_m"))
    if promised is not None:
        random = number(dig(sampling, "predicted", "random_rms_m"))
        rms = number(dig(sampling, "predicted", "rms_m"))
        more = "" if not random or not rms else f" ({rms / random:.2f} of what random poses promise, RMS)"
        rows.append(("Promised by the plan", mm(promised), f"The same, before anything moved{more}."))
    measured, wanted = dig(sampling, "measured"), dig(sampling, "wanted")
    if wanted is not None:
        rows.append(("Poses", f"{measured} of {wanted}", "Measured, of those that were wanted."))
    return section("Limits", facts(rows))
