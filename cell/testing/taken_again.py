"""Scenes on real time that a pause of this machine interrupted are played again, as a job takes a step again.

An interruption is what the product itself tells as one (``cell.interruptions.SILENCES``) where the scene did
not ask for it. Three in a row end it, as they end a run.
"""

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import pytest

from cell.errors import CellError, error
from cell.interruptions import SILENCES, InterruptionLimits

T = TypeVar("T")


def play(
    scene: Callable[[], Coroutine[Any, Any, T]],
    run: Callable[..., T] = asyncio.run,
    tidy: Callable[[], None] = lambda: None,
) -> T:
    """The result of ``scene``, run as a whole until nothing interrupts it; ``tidy`` comes between two."""
    for left in reversed(range(InterruptionLimits().in_a_row)):
        try:
            return run(scene())
        except CellError as failure:
            if failure.name not in SILENCES or not left:
                raise
            tidy()
    raise AssertionError("unreachable")


def interrupted(name: str, awaited: set[str]) -> None:
    """Play the scene again where it ended by an interruption ``name`` that is none of the ``awaited``."""
    if name in SILENCES - awaited:
        raise error(name, "a pause interrupted the scene")


@contextmanager
def ends_by(name: str, match: str | None = None) -> Iterator[None]:
    """What is within ends by the error ``name``; an interruption before that is passed on to :func:`play`."""
    with pytest.raises(CellError) as caught:
        yield
    found = caught.value
    if found.name in SILENCES - {name}:
        raise found
    assert found.name == name, found
    assert match is None or match in str(found), found
