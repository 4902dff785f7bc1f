"""Where joints come from: what a source of them does for the reader."""

from dataclasses import dataclass
from typing import Any, Protocol

from cell.devices import Identity
from cell.poses import Array


@dataclass(frozen=True)
class ObservedJoints:
    """Joints as a source found them at ``t`` give or take ``dt`` (s).

    ``rests`` is None when the source cannot tell, ``moving`` when the arm itself says that it moves.
    """

    q: Array  # (n,) rad or m
    t: float
    dt: float
    seq: int
    rests: bool | None = None
    moving: bool = False
    pose: int | None = None


class JointSource(Protocol):
    """One connection. ``look`` raises ``NoAnswer`` for what may pass, a coded error for what will not."""

    async def open(self) -> Identity: ...
    async def close(self) -> None: ...
    async def look(self, tick: int) -> list[ObservedJoints]:
        """What is new, oldest first."""
        ...

    async def request(self, number: int, q: Array) -> bool:
        """Offer a pose to the arm's program; False when there is no way to. Errors as ``look``."""
        ...

    def health(self) -> dict[str, Any]: ...
