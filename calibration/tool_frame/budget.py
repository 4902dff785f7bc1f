"""What makes up the uncertainty of a tool's point, before anything moves: polls, arm, and the tool's end."""

from collections.abc import Mapping

import numpy as np

from calibration.tool_frame.expected_height import ExpectedHeight
from calibration.tool_frame.prediction import ExpectedComparison

POLLS, REPEATABILITY, END = "polls", "repeatability", "end"
HELPS: Mapping[str, str] = {
    POLLS: "poll more often or lower measure_speed_m_s",
    REPEATABILITY: "take more passes",
    END: "give the tool a round end where it meets the beams, lower search_speed_m_s, or poll more often",
}


def budget(
    expected: ExpectedComparison,
    height: ExpectedHeight,
    without_noise: ExpectedComparison,
    height_without_noise: ExpectedHeight,
) -> dict[str, float]:
    """By term the part (m^2) of the variance of the point, of its three axes together.

    ``without_noise`` are the same predictions for an arm that repeats perfectly. The end's part is what a
    known shape would spare: across the beams nothing, and in height little while breaks of the light last
    for several polls. Where polls are further apart it is the greatest part of the height's variance, and
    can be that of the point, as a flat end is then not told from one that may be missed deep down.
    """
    across = float(np.trace(expected.cov[:2, :2]))
    polls = min(float(np.trace(without_noise.cov[:2, :2])), across)
    search = min(height_without_noise.known_end, height.known_end)
    return {
        POLLS: polls + search,
        REPEATABILITY: across - polls + height.known_end - search,
        END: height.variance - height.known_end,
    }


def dominating(parts: Mapping[str, float]) -> str:
    """The term with the greatest part."""
    return max(parts, key=lambda term: parts[term])
