"""A run of picking, drawn: outcomes over time, times of each contact, the zone, and the belt's speed."""

import numpy as np
import plotly.graph_objects as go

from procedures.belt.report.live import beside_section, speed_axis, thinned, trace
from procedures.belt.report.source import BeltSource
from procedures.report.figure import NOW, PALETTE, REJECTED, SOFT, dots, embed, figure, label, legend_below
from procedures.report.html import Html, absent, note, section
from procedures.report.numbers import dig, number

_MOST = 2000  # points of a line
_LAST_S = 30.0  # of the speed
_LAST_ITEMS = 80
_STEPS = (
    ("approach", "contact", "to the item"),
    ("contact", "gripped", "until it was held"),
    ("gripped", "picked", "to the place"),
)


def outcomes_section(source: BeltSource) -> Html | None:
    """How many items had ended which way by when."""
    title = "Picks and misses over time"
    if source.found is None:
        return None
    if not source.lives:
        return section(title, absent("No item had ended."))
    fig = figure(300)
    names = sorted({life.outcome for life in source.lives}, key=lambda name: (name != "picked", name))
    for k, name in enumerate(names):
        ends = np.array([life.end for life in source.lives if life.outcome == name])
        keep = np.unique(np.linspace(0, len(ends) - 1, min(len(ends), _MOST)).astype(int))
        fig.add_trace(
            go.Scatter(
                x=[0.0, *ends[keep]],
                y=[0, *(keep + 1)],
                mode="lines+markers",
                line={"shape": "hv", "color": PALETTE[k % len(PALETTE)], "width": 1.4},
                marker={"size": 4},
                name=label(name),
                hovertemplate=f"{label(name)} %{{y}} at %{{x:.1f}} s<extra></extra>",
            )
        )
    fig.update_xaxes(title_text="s since the journal was opened")
    fig.update_yaxes(title_text="items so far", rangemode="tozero")
    return section(title, embed(fig, "outcomes"))


def timing_section(source: BeltSource) -> Html | None:
    """How long each pick took, part by part."""
    title = "Times of each pick"
    picked = [life for life in source.lives if life.outcome == "picked"]
    if source.found is None:
        return None
    if not picked:
        return section(title, absent("Nothing was picked."))
    shown = picked[-_LAST_ITEMS:]
    fig = figure(340, barmode="stack")
    for k, (since, until, words) in enumerate(_STEPS):
        times = [life.took(since, until) for life in shown]
        fig.add_trace(
            go.Bar(
                x=[life.number for life in shown],
                y=times,
                name=words,
                marker={"color": PALETTE[k]},
                hovertemplate=f"item %{{x}} {words}: %{{y:.3f}} s<extra></extra>",
            )
        )
    fig.update_layout(legend=legend_below(340))
    fig.update_xaxes(title_text="item")
    fig.update_yaxes(title_text="s")
    held = [t for life in picked if (t := life.took("contact", "gripped")) is not None]
    usual = (
        f"Half of the items were held within {1e3 * float(np.median(held)):.0f} ms of contact. "
        if held
        else ""
    )
    return section(
        title,
        embed(fig, "timing"),
        note(f"{usual}'Until it was held' is the time of the grip; the tool moves with the item meanwhile."),
    )


def contacts_section(source: BeltSource) -> Html | None:
    """Where in the zone items were met; near its far edge the arm is at its limit."""
    title = "Where items were met"
    steps, zone = source.steps, dig(source.run, "job_config", "zone")
    if source.found is None:
        return None
    if isinstance(steps, str):
        return section(title, absent(steps))
    contacts = [(t, life) for life in source.lives if (t := life.at("contact")) is not None]
    if not contacts:
        return section(title, absent("There was no contact."))
    at = np.clip(np.searchsorted(steps["t"], [t + source.begin for t, _ in contacts]), 0, len(steps) - 1)
    along = steps["p"][at][:, :3] @ source.way
    fig = figure(300, showlegend=False)
    good = np.array([life.outcome == "picked" for _, life in contacts])
    for chosen, tint, words in ((good, NOW, "picked"), (~good, REJECTED, "not picked")):
        fig.add_trace(
            dots(
                np.array([t for t, _ in contacts])[chosen],
                1e3 * along[chosen],
                tint,
                f"%{{text}}, {words}: %{{y:.0f}} mm",
                size=6,
                text=[f"item {life.number}" for (_, life), c in zip(contacts, chosen, strict=True) if c],
            )
        )
    for key in ("min_m", "max_m"):
        if (edge := number(dig(zone, key))) is not None:
            fig.add_hline(y=1e3 * edge, line={"color": SOFT, "dash": "dot", "width": 1})
    fig.update_xaxes(title_text="s")
    fig.update_yaxes(title_text="along the belt, mm")
    return section(
        title,
        embed(fig, "contacts"),
        note("Dotted lines are the zone. Contacts that creep towards its end say that the arm is too slow."),
    )


def speed_section(source: BeltSource) -> Html | None:
    """The belt's speed count by count, and what the estimator made of it at the time."""
    title = "Speed of the belt"
    counts, steps, scale = source.counts, source.steps, source.scale
    if source.found is None:
        return None
    if isinstance(counts, str):
        return section(title, absent(counts))
    if isinstance(steps, str):
        return section(title, absent(steps))
    if scale is None:
        return section(title, absent("The result does not name the belt's scale."))
    since = float(steps["t"][-1]) - _LAST_S
    raw, filtered = counts[counts["t"] >= since], steps[steps["t"] >= since]
    dt = np.diff(raw["t"])
    v = np.where(dt > 0, np.diff(raw["count"]) * scale / np.where(dt > 0, dt, 1.0), np.nan)
    fig = figure(320)
    fig.add_trace(trace(*thinned(raw["t"][1:] - source.begin, v), SOFT, "from two counts", "markers", "m/s"))
    fig.add_trace(trace(filtered["t"] - source.begin, filtered["belt_m_s"], NOW, "estimated", "lines", "m/s"))
    fig.update_xaxes(title_text="s since the journal was opened")
    low, high = speed_axis(filtered["belt_m_s"])
    fig.update_yaxes(title_text="m/s", range=[low, high])
    outside = int(np.sum((v < low) | (v > high)))
    more = f" {outside} speeds from two counts lie beyond the axis." if outside else ""
    return section(
        title,
        embed(fig, "speed"),
        note(
            f"The last {_LAST_S:g} s. The line is what picking went by at that moment, without hindsight."
            f"{more}"
        ),
    )


def belief_section(source: BeltSource) -> Html | None:
    """Counts beside the position that was estimated when they came."""
    rows = source.belief
    if source.found is None:
        return None
    if isinstance(rows, str):
        return section("Counts beside the estimated position", absent(rows))
    last = rows[rows["t"] >= float(rows["t"][-1]) - _LAST_S]
    columns = {"t_s": last["t"], "raw_m": last["raw_m"], "travel_m": last["travel_m"]}
    return beside_section(columns, source.begin)
