"""The report of a run of picking: picks and misses with their causes, and the lives of the items."""

from dataclasses import replace

from procedures.belt.record import DATA_FILE
from procedures.belt.report.cover import tracking_cover
from procedures.belt.report.plots import (
    belief_section,
    contacts_section,
    outcomes_section,
    speed_section,
    timing_section,
)
from procedures.belt.report.source import BeltSource, ItemLife
from procedures.report.html import Html, absent, el, note, section, table
from procedures.report.layout import Layout, Page
from procedures.report.numbers import DASH, mm
from procedures.report.origin import inputs_section
from procedures.report.timeline import timeline
from procedures.report.verdict import banner, cards

_CAUSES = {
    "not detected": "Seen less often than min_sightings: look at light, items and the camera's view.",
    "out of zone": "Left the zone before the arm was free: a slower feed, a longer zone, or a faster arm.",
    "lost": "Fell from the gripper on its way, or was taken by somebody: look at grip and weight.",
    "grip failed": "The gripper closed on nothing: look at contact timing, grip_m and the calibrations.",
    "queue full": "More than queue_limit on their way: a slower feed; or the camera sees items in the belt.",
}
_MOST_ITEMS = 60
_MOST_LINES = 4000  # of the journal; a day of picking has a hundred times as many


def verdict_section(source: BeltSource) -> Html:
    """The verdict, why, and four figures to take away."""
    top = banner(source, {}, "Correct what the reason names, and start again.")
    if source.found is None:
        return top
    answer = source.found.result
    rate, success = answer.picks_per_minute, answer.success
    return Html(
        top
        + cards(
            (
                (str(answer.picks), "items picked"),
                (DASH if rate is None else f"{rate:.1f}", "picks per minute, waiting included"),
                (DASH if success is None else f"{100 * success:.1f} %", "of those that were tried"),
                (str(sum(answer.misses.values())), f"missed of {answer.seen} seen"),
            )
        )
    )


def causes_section(source: BeltSource) -> Html | None:
    """Misses by their causes, with what to look at."""
    if source.found is None:
        return None
    misses = source.found.result.misses
    rows = [(el("b", cause), misses.get(cause, 0), words) for cause, words in _CAUSES.items()]
    rows += [(el("b", cause), n, "") for cause, n in misses.items() if cause not in _CAUSES]
    left = source.found.result.counters.get("queue_length")
    return section(
        "Misses by cause",
        table(("cause", "items", "what to look at"), rows, "lrl"),
        note(f"{left} items were still on their way when the run ended.") if left is not None else None,
    )


def lives_section(source: BeltSource) -> Html | None:
    """What happened to each item, the last of them."""
    title = "Items"
    if not source.lives:
        return section(title, absent("No item had ended."))
    shown = source.lives[-_MOST_ITEMS:]
    more = len(source.lives) - len(shown)
    return section(
        title,
        table(
            ("item", "became", "sightings", "contact, 95 %", "seen, s", "then, s later"),
            [
                (
                    life.number,
                    el("b", life.outcome),
                    life.sightings,
                    mm(life.contact_95_m),
                    _first(life),
                    _then(life),
                )
                for life in shown
            ],
            "rlrrrl",
        ),
        note(f"{more} earlier ones are in journal.jsonl and in the ledger.") if more > 0 else None,
    )


def _first(life: ItemLife) -> str:
    return f"{life.history[0][0]:.2f}" if life.history else DASH


def _then(life: ItemLife) -> str:
    begin = life.history[0][0] if life.history else 0.0
    return ", ".join(f"{what} {t - begin:.2f}" for t, what in life.history[1:])


def run_section(source: BeltSource) -> Html | None:
    """The run's states; of a long run, the last of them."""
    lines = [line for line in source.journal if line.get("event") != "item"]
    cut = len(lines) > _MOST_LINES
    return timeline(
        replace(source, journal=lines[-_MOST_LINES:]), "The last part of a long run" if cut else ""
    )


def _page(_source: BeltSource) -> Page[BeltSource]:
    return Page(
        top=(verdict_section, outcomes_section),
        left=(timing_section,),
        right=(causes_section, contacts_section),
        rest=(speed_section, belief_section, lives_section, run_section, inputs_section),
    )


BELT_TRACKING = Layout(
    source=BeltSource,
    data_file=DATA_FILE,
    title=lambda _source: "Picking from the belt",
    page=_page,
    cover=tracking_cover,
)
