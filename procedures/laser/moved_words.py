"""What a check says of a tool that has moved or has not; ``test`` is what ``whether_moved`` found."""

from math import degrees

from procedures.laser.result import MovedTest

NAME = "tool moved"  # what the reason of such a verdict begins with


def moved_reasons(test: MovedTest) -> list[str]:
    """Why the tool counts as moved, and what to do; empty when it has not."""
    reasons = []
    if test.shift_m > test.tolerance_m:
        reasons.append(f"{NAME}: the tool's point has moved by {point_words(test)}: run laser-update")
    if test.tilt_rad is not None and test.tolerance_rad is not None and test.tilt_rad > test.tolerance_rad:
        reasons.append(f"{NAME}: the tool's axis has turned by {axis_words(test)}: run laser-update")
    return reasons


def point_words(test: MovedTest) -> str:
    """How far the point moved: ``1.49 mm (uncertainty 0.036 mm, tolerance 0.10 mm)``."""
    return (
        f"{1e3 * test.shift_m:.2f} mm (uncertainty {1e3 * test.U_shift_m:.3f} mm, "
        f"tolerance {1e3 * test.tolerance_m:.2f} mm)"
    )


def axis_words(test: MovedTest) -> str:
    """By how much the axis turned, ``0.57 deg (uncertainty 0.15 deg, tolerance 0.20 deg)``; empty when it
    was not measured."""
    if test.tilt_rad is None or test.U_tilt_rad is None or test.tolerance_rad is None:
        return ""
    return (
        f"{degrees(test.tilt_rad):.2f} deg (uncertainty {degrees(test.U_tilt_rad):.2f} deg, "
        f"tolerance {degrees(test.tolerance_rad):.2f} deg)"
    )
