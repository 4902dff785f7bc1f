"""What makes up the uncertainty of a tool's point, before anything moves: polls, arm, and the tool's end."""

from collections.abc import Mapping

import numpy as np

from calibration.tool_frame.prediction import ExpectedComparison, height_variance

POLLS, REPEATABILITY, END = "polls", "repeatability", "end"
HELPS: Mapping[str, str] = {
    POLLS: "poll more often or lower measure_speed_m_s",
    REPEATABILITY: "take more passes",
    END: "give the tool a round end where it meets the beams",
}


def budget(
    expected: ExpectedComparison, without_noise: ExpectedComparison, sigma_m: float, pairs: float
) -> dict[str, float]:
    """By term the part (m^2) of the variance of the point, of its three axes together.

    ``without_noise`` is the same prediction for an arm that repeats perfectly; ``sigma_m`` what a single way
    scatters by along the tool, and ``pairs`` how many ways there and back are near the tool's end. The end's
    part is what hits and misses of a flat end tell less than the widths of a round one.
    """
    both = float(np.trace(expected.cov[:2, :2]))
    polls = min(float(np.trace(without_noise.cov[:2, :2])), both)
    across = both - polls
    search = height_variance(expected.z_resolution_m, 0.0, pairs)
    flat = height_variance(0.0, sigma_m, pairs)
    round_ = flat * 2.0 / float(np.pi)
    return {POLLS: polls + search, REPEATABILITY: across + round_, END: flat - round_}


def dominating(parts: Mapping[str, float]) -> str:
    """The term with the greatest part."""
    return max(parts, key=lambda term: parts[term])
