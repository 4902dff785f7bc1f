"""A touch test in words: what is asked of a person, and what tool, camera and arm are off by."""

from procedures.touch_test.result import TouchResult
from procedures.words import deg, mm, table


def corner_text(where: str, target: str, corner: int, stand_off_m: float) -> str:
    """What a person is asked to do at a corner."""
    return (
        f"At {where} of '{target}' (point {corner}) jog the arm until the tool's point truly stands over "
        f"that corner with the gauge of {mm(stand_off_m, 1)} between; leave it where it does. Then take hand "
        "and gauge away, leave the arm's reach, and confirm, or skip this corner: the arm "
        "moves then, and on a finish."
    )


def touch_lines(found: TouchResult) -> list[str]:
    """Shift and turn with their uncertainty, each corner, and what is open."""
    answer, of = found.result, found.uncertainty
    corners = [[f"  {c.corner}", *(f"{1e3 * v:.3f}" for v in c.off)] for c in answer.corners]
    sources = [["  " + cause.source, mm(cause.sigma_m)] for cause in of.by_source]
    return [
        f"  off at the board by {mm(answer.shift_m)} +- {mm(of.shift_95_m)} (95 %), turned by "
        f"{deg(answer.turn_rad)} +- {deg(of.turn_95_rad)}",
        f"  a cell in which nothing is off shows as much in {_percent(answer.chance)} % of tests",
        table(("  corner", "x (mm)", "y (mm)", "z (mm) of the target"), corners),
        table(("  open, one standard deviation of an axis", ""), sources),
        f"  the corners scatter by {mm(found.residuals.rms_m)}",
        *(f"  not told: {words}" for words in found.observability.undetermined),
    ]


def _percent(share: float) -> str:
    """Two digits of a small one, and no decimals of a large one."""
    percent = 100 * share
    return f"{percent:.2g}" if percent < 10 else f"{percent:.0f}"
