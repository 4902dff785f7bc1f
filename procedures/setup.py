"""What a job's expectation knows of a cell: its configuration alone, before anything moves."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel

from calibration.targets import make_target
from cell.run_values import RunValues

M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True)
class Setup:
    """A cell as configured; the ledger and the devices may know better when a job starts.

    ``roles``: role -> device; ``devices``: device -> its section, as its driver defines it. ``values``: arm,
    tool, payload, limits, poses, targets and the nominal belt. ``nominal``: poses of cameras and target from
    the drawing, (6,) m and rad, by the key of ``[robot]``. ``jobs``: the sections of all configured jobs.
    ``calibrations``: what the ledger has, newest first; a ``CellError`` when it cannot be read. ``stated``:
    by name, what the result in effect states of its uncertainty, as ``RunValues.uncertainty``; likewise.
    """

    roles: Mapping[str, str]
    devices: Mapping[str, Any]
    values: RunValues
    nominal: Mapping[str, Sequence[float] | None]
    jobs: Sequence[BaseModel]
    calibrations: Callable[[], list[dict[str, Any]]]
    stated: Callable[[str], Mapping[str, Any]] = lambda name: {}

    @property
    def poses(self) -> Mapping[str, Sequence[float]]:
        """Taught joint angles by name, rad."""
        return self.values.poses

    def committed(self, name: str) -> dict[str, Any] | None:
        """The version of ``name`` in effect, None without one; a ``CellError`` as of ``calibrations``."""
        rows = self.calibrations()
        return next((row for row in rows if (row["name"], row["state"]) == (name, "committed")), None)

    def job(self, section: type[M]) -> M | None:
        """The configured job whose section is of this model, None without one."""
        return next((job for job in self.jobs if isinstance(job, section)), None)

    def observed_ranges(self) -> Sequence[Sequence[float]] | None:
        """[low, high] of each joint (rad) of the observed arm, as the job has them that samples it."""
        jobs = (job for job in self.jobs if getattr(job, "arm", None) == "observed_arm")
        return next((found for job in jobs if (found := getattr(job, "joint_ranges_rad", None))), None)

    def without_depth(self, role: str) -> bool:
        """Whether the camera of this role is configured to be one without depth."""
        return getattr(self.devices.get(self.roles.get(role, "")), "depth", True) is False

    def missing(self, *roles: str) -> list[str]:
        """One sentence for each of these roles that no device plays."""
        return [
            f"[robot] names no device for {role}, which the job needs; add it"
            for role in roles
            if role not in self.roles
        ]

    def unseen(self, target: str, min_corners: int | None = None) -> list[str]:
        """Why no picture will show enough of a target; nothing where one can."""
        spec = self.values.targets.get(target)
        if spec is None:
            return [f"target = '{target}' is no [target.NAME] section; add it or name another"]
        if spec["type"] == "points":
            return [
                f"target '{target}' is of the type points, which no picture shows; use one that is printed"
            ]
        if min_corners is not None and (points := len(make_target(spec).points)) < min_corners:
            return [f"min_corners is {min_corners}, and the target '{target}' has {points} points; lower it"]
        return []
