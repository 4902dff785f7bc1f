"""The first page of a hand-eye report."""

from calibration.lengths import length95
from procedures.hand_eye.report.source import HandEyeSource
from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import covariance, deg, dig, mm, mms

_CHANGES = "what changes while the poses are taken: a loose bracket, a warm-up, a board that bends"
_MOTOR = "errors on a motor's side of a gear"
_PARTS = ("arm", "lens", "target")


def hand_eye_cover(source: HandEyeSource) -> Cover:
    """Where the camera is, how well that is known, and what was promised before anything moved."""
    found, X = source.found, source.X
    if found is None or X is None:
        return Cover()
    limits, promised = dig(source.run, "job_config", "accept"), _promised(source)
    cov = covariance(found.result.cov)
    t95, r95 = (None, None) if cov is None else (length95(cov[:3, :3]), length95(cov[3:, 3:]))
    held = found.heldout.rms
    figures = [
        CoverFigure(f"camera in {source.parent}: x, y, z", ", ".join(mms(X[:3, 3])) + " mm"),
        judged(
            "95 % error of its position",
            t95,
            dig(limits, "max_error_t_m"),
            mm,
            planned=_text(promised, "error95_t_m", mm),
        ),
        judged(
            "95 % error of its rotation",
            r95,
            dig(limits, "max_error_r_rad"),
            deg,
            planned=_text(promised, "error95_r_rad", deg),
        ),
        CoverFigure("held-out check, RMS", f"{mm(held.t)}, {deg(held.r)}"),
        CoverFigure("observations used", f"{found.inputs.used} of {found.inputs.observations}"),
    ]
    covers = found.uncertainty.covers or []
    open_ = [f"errors of the {part}: it is taken as exact" for part in _PARTS if part not in covers]
    if "arm" in covers and "gears" not in covers:
        open_.append("errors of the arm that neighbouring poses do not share, as those of other branches")
    open_ += [*found.observability.unobservable, _CHANGES, *([_MOTOR] if "gears" in covers else [])]
    return Cover(figures, open_)


def _promised(source: HandEyeSource) -> object:
    """The prediction of the last plan; the poses of earlier placements are in it."""
    plans = [e.get("plan") for e in source.journal if e.get("event") == "plan"]
    return dig(plans[-1], "predicted") if plans else None


def _text(promised: object, key: str, shown: object) -> str:
    value = dig(promised, key)
    return "" if value is None else str(shown(value))  # type: ignore[operator]
