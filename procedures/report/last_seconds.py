"""What the devices told in the seconds before a run failed: joint speeds, force, levels and counts."""

from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.store.files import read_json
from cell.store.runs import LAST_SECONDS_FILE
from procedures.report.figure import PALETTE, embed, figure, label, polyline
from procedures.report.html import Html, join, note, section

_HEIGHT = 230
# What is drawn, by its unit, and the unit for people. Where joints stand says little beside their speed.
_SHOWN = {"rad/s": ("deg/s", degrees(1.0)), "N": ("N", 1.0), "": ("", 1.0)}


def last_seconds_section(folder: Path | None) -> Html | None:
    """None where the run has no such file; a damaged one is said to be."""
    if folder is None or not (folder / LAST_SECONDS_FILE).is_file():
        return None
    title = "The last seconds"
    try:
        devices = read_json(folder / LAST_SECONDS_FILE)["devices"]
        drawn = [one for name, told in devices.items() for one in _figures(str(name), told)]
    except (CellError, KeyError, TypeError, ValueError, AttributeError) as exc:
        return section(title, note(f"{LAST_SECONDS_FILE} cannot be read: {type(exc).__name__}: {exc}"))
    if not drawn:
        return section(title, note("The links of all devices were opened anew since then."))
    return section(title, note("Time to the end of the run, s."), join(drawn))


def _figures(name: str, told: dict[str, Any]) -> list[Html]:
    columns, rows = told["columns"], told["rows"]
    times = [row[0] for row in rows]
    found: list[Html] = []
    for unit, (shown, factor) in _SHOWN.items():
        picked = [k for k, (_, its) in enumerate(columns, 1) if its == unit]
        if not picked:
            continue
        fig = figure(_HEIGHT, xaxis_title="s", yaxis_title=label(f"{name}, {shown}" if shown else name))
        for place, k in enumerate(picked):
            values = [factor * float(row[k]) for row in rows]
            lift = _lift(columns, picked, place)
            said = f"{label(columns[k - 1][0])}: %{{y}}"
            fig.add_trace(
                polyline(
                    times,
                    [v + lift for v in values],
                    PALETTE[place % len(PALETTE)],
                    said,
                    name=label(columns[k - 1][0]),
                )
            )
        found.append(embed(fig, f"last-{name}-{len(found)}"))
    return found


def _lift(columns: Sequence[Sequence[str]], picked: Sequence[int], place: int) -> float:
    """Levels of several inputs are drawn one above the other."""
    levels = len(picked) > 1 and all(not columns[k - 1][1] for k in picked)
    return 1.5 * place if levels else 0.0
