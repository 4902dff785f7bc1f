"""The run as it went: a strip of its states, and the entries of its journal that a reader asks about."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import plotly.graph_objects as go

from procedures.report.figure import colour, embed, figure
from procedures.report.html import Html, absent, note, section, table
from procedures.report.numbers import dig, mm, number
from procedures.report.source import Source

_ROUTINE_EVENTS = {"pose taken", "lease", "move_joints", "move_linear", "standstill", "stream"}
_MOST_ROWS = 200


def timeline_section(source: Source[Any]) -> Html | None:
    """The run of a result of any kind."""
    return timeline(source)


def events(source: Source[Any], *names: str) -> Counter[str]:
    """How often each of the events ``names`` stands in the journal; those that do not are left out."""
    return Counter(str(e["event"]) for e in _timed(source) if e.get("event") in names)


def timeline(
    source: Source[Any], summary: str = "", *, routine: bool = False, newest: int | None = None
) -> Html | None:
    """``summary`` (without its full stop), a strip of the states, and a table; None without a run.

    With ``routine`` the table has every entry, moves and leases too. With ``newest`` only so many are shown,
    in seconds of the whole journal all the same.
    """
    if not source.run and not source.journal:
        return None
    title = "The run"
    entries = _timed(source)
    if not entries:
        return section(title, absent("The journal has no entries."))
    origin = float(entries[0]["t"])
    entries = entries[-newest:] if newest is not None else entries
    shown = [e for e in entries if routine or _notable(e)]
    rows = [(f"{e['t'] - origin:.1f}", e.get("kind"), _what(e)) for e in shown]
    more = len(rows) - _MOST_ROWS
    return section(
        title,
        note(f"{summary}.") if summary else None,
        _strip(entries, origin),
        table(("s", "kind", "what"), rows[:_MOST_ROWS], "rl"),
        note(f"{more} more entries are in journal.jsonl.") if more > 0 else None,
    )


def _timed(source: Source[Any]) -> list[dict[str, Any]]:
    return [e for e in source.journal if number(e.get("t")) is not None]


def _notable(entry: Mapping[str, Any]) -> bool:
    if entry.get("kind") in ("operator", "error", "device", "solve") or entry.get("terminal"):
        return True
    if entry.get("kind") == "state":
        return entry.get("packml") not in (None, "EXECUTE")
    return entry.get("kind") != "header" and entry.get("event") not in _ROUTINE_EVENTS


def _what(entry: Mapping[str, Any]) -> str:
    if entry.get("terminal"):
        return f"end: {entry.get('outcome')}"
    event = str(entry.get("event") or entry.get("packml") or entry.get("state") or entry.get("text") or "")
    if event == "plan":
        return _plan(entry)
    details = [str(entry[key]) for key in ("why", "text") if entry.get(key) and str(entry[key]) != event]
    for key, words in (
        ("pose", "pose"),
        ("who", "by"),
        ("observations", "observations"),
        ("poses", "poses"),
        ("beam", "beam"),
        ("name", "of"),
        ("version", "version"),
    ):
        if entry.get(key) is not None:
            details.append(f"{words} {entry[key]}")
    return ": ".join([event, ", ".join(details)]) if details else event


def _plan(entry: Mapping[str, Any]) -> str:
    plan = entry.get("plan")
    if dig(plan, "sweeps") is not None:
        problems = "; ".join(str(p) for p in dig(plan, "problems") or [])
        return f"plan: {dig(plan, 'note')}" + (f"; not possible: {problems}" if problems else "")
    poses, rejected = dig(plan, "poses") or [], dig(plan, "rejected") or []
    placed = "" if entry.get("group") is None else f" of placement {int(entry['group']) + 1}"
    text = f"plan{placed}: {len(poses)} poses"
    predicted = dig(plan, "predicted", "error95_t_m")
    if predicted is not None:
        text += f", predicted 95 % error {mm(predicted)}"
    if rejected:
        reasons = Counter(str(dig(r, "reason")) for r in rejected)
        text += "; left out: " + "; ".join(f"{why} ({n})" for why, n in reasons.most_common(5))
    return text


def _strip(entries: list[dict[str, Any]], origin: float) -> Html | None:
    """One bar for each stay in a state, from entering it to entering the next."""
    changes = [(float(e["t"]) - origin, str(e["state"])) for e in entries if isinstance(e.get("state"), str)]
    if len(changes) < 2:
        return None
    last = max(float(e["t"]) - origin for e in entries)
    ends = [t for t, _ in changes[1:]] + [last]
    order = list(dict.fromkeys(state for _, state in changes))
    fig = figure(90 + 24 * len(order), barmode="overlay", showlegend=False)
    for number_, state in enumerate(order):
        spans = [(t, end - t) for (t, name), end in zip(changes, ends, strict=True) if name == state]
        fig.add_trace(
            go.Bar(
                orientation="h",
                y=[state] * len(spans),
                base=[t for t, _ in spans],
                x=[length for _, length in spans],
                marker={"color": colour(range(len(order)), number_), "line": {"width": 0}},
                hovertemplate="%{base:.1f} s, for %{x:.1f} s<extra></extra>",
            )
        )
    fig.update_yaxes(autorange="reversed")
    fig.update_xaxes(title_text="s since the journal was opened")
    fig.update_layout(margin={"l": 100, "t": 10})
    return embed(fig, "timeline")
