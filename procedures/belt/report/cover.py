"""The first pages of the reports about a belt: of its calibration, and of picking from it."""

from procedures.belt.report.source import BeltSource
from procedures.belt.result import BeltCalibrationResult
from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import DASH, dig, mm
from procedures.report.source import Source

_SLIP = "slip between belt and encoder after this run, and a belt that wears or is tightened anew"
_COUNTED = (
    "the rate of a future run: picks and misses are counts of this run alone, with its items, speed and light"
)


def calibration_cover(source: Source[BeltCalibrationResult]) -> Cover:
    """Scale and direction with their intervals beside the limits of the job."""
    found = source.found
    if found is None:
        return Cover()
    answer, limits = found.result, dig(source.run, "job_config", "accept")
    half, scale = found.uncertainty.half_m_per_count, answer.m_per_count
    share = None if half is None or not scale else half / abs(scale)
    level, rise = found.direction_95_rad()
    figures = [
        CoverFigure(
            "travel of one count",
            f"{1e6 * scale:.3f} µm",
            "" if half is None else f"± {1e6 * half:.3f} µm",
        ),
        judged("the same, share of it", share, dig(limits, "max_scale_share"), _percent),
        judged("95 % interval of the direction, seen from above", level, dig(limits, "max_dir_rad"), _mrad),
        judged("95 % interval of how it rises", rise, dig(limits, "max_rise_rad"), _mrad),
        judged("sightings set aside, RMS", found.heldout.rms_m, dig(limits, "max_heldout_m"), mm),
    ]
    return Cover(figures, [*found.observability.undetermined, _SLIP])


def tracking_cover(source: BeltSource) -> Cover:
    """Picks and misses by cause; they are counts, and have no limit of their own."""
    found = source.found
    if found is None:
        return Cover()
    answer = found.result
    missed = ", ".join(f"{cause} {n}" for cause, n in answer.misses.items() if n)
    rate, success, follow = answer.picks_per_minute, answer.success, answer.following_largest_m
    limit = dig(source.run, "job_config", "following_limit_m")
    figures = [
        CoverFigure("items picked", f"{answer.picks} of {answer.seen} seen"),
        CoverFigure("items missed", missed or "none"),
        CoverFigure("picked of those tried", DASH if success is None else _percent(success)),
        CoverFigure("picks per minute", DASH if rate is None else f"{rate:.1f}"),
        CoverFigure("duration", f"{answer.duration_s:.0f} s"),
    ]
    if follow is not None:
        figures.append(judged("tool beside its set-points, largest", follow, limit, mm))
    if (off := answer.contact_off_largest_m) is not None:
        figures.append(
            judged("item beside the set-point at contact by later counts, largest", off, limit, mm)
        )
    if (known := answer.camera_delay_95_s) is not None:
        figures.append(CoverFigure("delay of the camera, 95 %", f"{1e3 * known:.2f} ms"))
    if (stated := answer.contact_95_m) is not None:
        figures.append(judged("contacts off by all that is known, 95 %", stated, limit, mm))
    assumed = [f"by an assumption, not measured: {what}" for what in answer.contact_95_assumed or ()]
    return Cover(figures, [*assumed, *(answer.contact_95_without or ()), _COUNTED])


def _percent(share: float | None) -> str:
    return DASH if share is None else f"{100 * share:.3g} %"


def _mrad(angle: float | None) -> str:
    return DASH if angle is None else f"{1e3 * angle:.2f} mrad"
