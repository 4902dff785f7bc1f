"""The report of a delay: how late the device is, how sure that is, and what it rests on."""

from procedures.latency.cover import latency_cover
from procedures.latency.result import LatencyResult
from procedures.latency.solver import BELT_SIGHTINGS, DATA_FILE, TARGET_IN_PICTURES
from procedures.report.html import Html, bullets, el, facts, section
from procedures.report.layout import Layout, Page
from procedures.report.numbers import DASH, mm
from procedures.report.origin import inputs_section
from procedures.report.source import Source
from procedures.report.timeline import timeline_section
from procedures.report.trend import trend_section
from procedures.report.verdict import banner, cards
from procedures.words import ms

_REMEDY = {
    "one-way": "Let every way out have its way back, and measure again.",
    "too-few-passes": "Take more passes.",
    "too-few-pictures": "Put the target in view all the way, or take more passes.",
    "too-few-sightings": "Put items on the belt, close to each other, and measure again.",
    "steady-belt": "Start and stop the belt while items are in view of the camera.",
    "max_interval_s": "Take more passes, or more starts and stops of the belt.",
    "max_offset_s": "Look for a stalled or overloaded device; raise the limit when it is truly so late.",
}
_READINGS = {TARGET_IN_PICTURES: "pictures of the target", BELT_SIGHTINGS: "sightings of items"}


def verdict_section(source: Source[LatencyResult]) -> Html:
    """The verdict, why, and the figures to take away."""
    top = banner(source, _REMEDY, "Correct what the reason names, and measure again.")
    if source.found is None:
        return top
    answer, found = source.found.result, source.found
    low, high = answer.interval95_s
    held_out = found.heldout.rms_m
    return Html(
        top
        + cards(
            (
                (ms(answer.time_offset_s, 3), f"by which stamps of '{answer.source}' are late"),
                (f"{ms(low, 3)} … {ms(high, 3)}", "95 % interval"),
                (
                    DASH if held_out is None else mm(held_out),
                    "RMS of readings that were set aside, along the way",
                ),
                (str(found.residuals.edges), _READINGS.get(_signal(source), "edges in the beam")),
            )
        )
    )


def conditions_section(source: Source[LatencyResult]) -> Html | None:
    """What the number means, what was found beside it, and what stays open."""
    if source.found is None:
        return None
    answer, uncertainty = source.found.result, source.found.uncertainty
    rows: list[tuple[str, object, str]] = [
        (
            "Subtracted already",
            ms(answer.applied_s, 3),
            "By the driver, time_offset_s of its section. A version in effect replaces it for every job that "
            "uses the device.",
        ),
        (
            "At a speed of 0.15 m/s",
            mm(0.15 * answer.time_offset_s),
            "So far something is taken to be elsewhere, without the correction.",
        ),
    ]
    if answer.hysteresis_m is not None:
        rows.append(("Hysteresis", mm(answer.hysteresis_m), "Found with the delay: the same at every speed."))
    if uncertainty.camera_sigma_s is not None:
        rows.append(
            (
                "Of the camera",
                ms(uncertainty.camera_sigma_s, 3),
                "Standard deviation of its own delay, which the interval of the encoder's has in it.",
            )
        )
    still_open = source.found.observability.undetermined
    rest = (el("h3", "Not measured"), bullets(still_open)) if still_open else ()
    return section("What it means", facts(rows), *rest)


def _signal(source: Source[LatencyResult]) -> str:
    job = source.run.get("job_config")
    named = job.get("source", "") if isinstance(job, dict) else ""
    return BELT_SIGHTINGS if named == "belt" else TARGET_IN_PICTURES if "camera" in named else ""


def _page(_source: Source[LatencyResult]) -> Page[Source[LatencyResult]]:
    rest = (trend_section, timeline_section, inputs_section)
    return Page(top=(verdict_section, conditions_section), left=(), right=(), rest=rest)


def _title(source: Source[LatencyResult]) -> str:
    return "Delay" if source.found is None else f"Delay of '{source.found.result.source}'"


LATENCY = Layout(source=Source, data_file=DATA_FILE, title=_title, page=_page, cover=latency_cover)
