"""The verdict of a check: the given hand-eye and the target's place against their limits."""

from collections.abc import Iterator
from dataclasses import dataclass

from cell.formats.axbc import Limits
from procedures.eye_to_hand.result import AxbcAnswer
from procedures.words import deg, mm

HAND_EYE, PLACE = "hand-eye.off", "target.place"
_SURE = 2.0  # standard deviations


@dataclass(frozen=True)
class _Held:
    """What is off in words, the least and the most of it (95 %), and its limit; m or rad."""

    said: str
    least: float
    most: float
    limit: float
    shown: str


def reasons_against(answer: AxbcAnswer, limits: Limits) -> list[str]:
    """Why the given hand-eye is surely beyond a limit, each reason with the limit's name."""
    return [f"{h.said}, the limit is {h.shown}" for h in _held_against(answer, limits) if h.least > h.limit]


def doubts_about(answer: AxbcAnswer, limits: Limits) -> list[tuple[str, str]]:
    """Where the data cannot tell whether the given hand-eye is within its limits."""
    return [
        (HAND_EYE, f"{h.said}, so these data cannot tell whether it is within {h.shown}")
        for h in _held_against(answer, limits)
        if h.least <= h.limit < h.most
    ]


def blame_warning(answer: AxbcAnswer) -> list[tuple[str, str]]:
    """What is to be said of the part that does not fit."""
    blamed = answer.blamed
    if blamed == "C":
        off = f"{mm(answer.C_offset.t)} and {deg(answer.C_offset.r)}"
        text = (
            f"C as given is off by {off} and only 'mean' uses it: "
            "measure the target's place on the flange again"
        )
        return [(PLACE, text)]
    if blamed == "X":
        return [(HAND_EYE, "the given hand-eye does not fit the images, and the target's place does")]
    if blamed == "cannot-tell":
        text = (
            "hand-eye and place of the target contradict each other, and the data cannot tell which is "
            "wrong: T_camera_base uses neither of them, and of all figures only 'mean' uses the place"
        )
        return [(HAND_EYE, text)]
    return []


def _held_against(answer: AxbcAnswer, limits: Limits) -> Iterator[_Held]:
    size, sigma = answer.eval, answer.eval_sigma
    for name, off, own, limit, words in (
        ("max_error_t_m", size.t, sigma.t, limits.t, mm),
        ("max_error_r_rad", size.r, sigma.r, limits.r, deg),
    ):
        twice = _SURE * own
        said = f"{name}: the given hand-eye is off by {words(off)} +- {words(twice)} (95 %)"
        yield _Held(said, off - twice, off + twice, limit, words(limit))
