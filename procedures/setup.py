"""What a job's expectation knows of a cell: its configuration alone, before anything moves."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel

from calibration.targets import make_target
from cell.run_values import RunValues

M = TypeVar("M", bound=BaseModel)
_NEAR = 0.8  # of a timeout


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

    @property
    def gripper_moves_s(self) -> float | None:
        """How long the gripper takes to close or to open by its own section, s; None where that says
        nothing."""
        moves_s = getattr(self.devices.get(self.roles.get("gripper", "")), "moves_s", None)
        return None if moves_s is None else float(moves_s)

    def gripper_in_time(self, key: str, timeout_s: float) -> tuple[list[str], list[str]]:
        """What is wrong, and what looks mistaken, where the gripper by its own section needs longer than the
        key ``key`` of a job waits for it."""
        moves_s = self.gripper_moves_s
        if moves_s is None or moves_s <= _NEAR * timeout_s:
            return [], []
        name = self.roles["gripper"]
        text = f"{key} = {timeout_s:g} s, and [device.{name}] moves_s is {moves_s:g} s: "
        if moves_s <= timeout_s:
            return [], [f"{text}that leaves little more; make {key} longer"]
        if getattr(self.devices[name], "confirm", None) is not None:
            return [], [f"{text}every grip would count as failed; make {key} longer"]
        return [f"{text}the gripper refuses to move; make {key} longer"], []

    def gripper_confirms_nothing(self) -> list[str]:
        """What may look better than it is where, by its own section, nothing tells what the gripper holds."""
        name = self.roles.get("gripper", "")
        section = self.devices.get(name)
        if self.gripper_moves_s is None or getattr(section, "confirm", None) is not None:
            return []
        return [
            f"[device.{name}] has no confirm: each grip counts as good once its time is over, also where "
            "nothing is held; wire a vacuum switch or a sensor in the fingers, and give it as confirm"
        ]

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
