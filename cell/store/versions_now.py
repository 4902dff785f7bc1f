"""The calibrations in effect as everybody may read them without waiting for the disk."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class LastChange:
    """What was put into effect last, by a commit or, of the version before, by a rollback.

    ``count`` goes on with each change, ``at`` is the time of day, s.
    """

    count: int
    name: str
    at: float


@dataclass(frozen=True)
class VersionsNow:
    """One state of the ledger. ``versions`` has the version in effect by name; a name without one is as
    configured. ``poses`` has the values of those whose name begins with ``T_``: m, and rotation vector."""

    change: LastChange | None = None
    versions: Mapping[str, int] = field(default_factory=dict)
    poses: Mapping[str, Any] = field(default_factory=dict)
