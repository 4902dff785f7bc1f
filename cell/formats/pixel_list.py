"""Pixels of the corners of one observation, as numbers in a row instead of a list of lists.

A data set of thousands of poses has hundreds of thousands of corners. As lists of Python's numbers they take
ten times the memory of the numbers, and most of it does not come back when they are gone.
"""

from array import array
from collections.abc import Callable, Sequence
from typing import Annotated, Any

from pydantic import WrapValidator

from cell.formats.bounds import PIXEL, Pixel

_NAN = float("nan")


class PixelList(Sequence[list[float] | None]):
    """``[u, v]`` px of each point of a target, None where it was not seen; within the bounds of a pixel."""

    def __init__(self, numbers: "array[float]") -> None:
        self._numbers = numbers  # u, v of one point after the other, NaN where it was not seen

    def __len__(self) -> int:
        return len(self._numbers) // 2

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(len(self))[k]]
        i = 2 * range(len(self))[k]
        u, v = self._numbers[i : i + 2]
        return None if u != u else [u, v]

    def __repr__(self) -> str:
        return repr(list(self))


def pixel_list(found: object) -> object:
    """``found`` as a :class:`PixelList` where it is a list of pixels without a fault, else as it is."""
    if not isinstance(found, list) or not found:
        return found
    numbers: list[float] = []
    for pixel in found:
        if pixel is None:
            numbers += (_NAN, _NAN)
        elif isinstance(pixel, list) and len(pixel) == 2 and _is_number(pixel[0]) and _is_number(pixel[1]):
            numbers += pixel
        else:
            return found
    return PixelList(array("d", numbers))


def _is_number(v: object) -> bool:
    return type(v) in (float, int) and -PIXEL <= v <= PIXEL  # type: ignore[operator]


def _as_it_is(found: Any, check: Callable[[Any], Any]) -> Any:
    return found if isinstance(found, PixelList) else check(found)


Corners = Annotated[list[Pixel | None], WrapValidator(_as_it_is)]
