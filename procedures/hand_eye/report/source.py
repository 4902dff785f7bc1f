"""What the sections of a hand-eye report ask for: X, the targets, the pose before, the poses measured."""

from dataclasses import dataclass
from functools import cached_property

from calibration.hand_eye.observability import axes_frame
from cell.errors import CellError
from cell.poses import Array
from procedures.hand_eye.report.measured import MeasuredPoses, measure
from procedures.hand_eye.result import HandEyeResult
from procedures.report.numbers import dig, matrix4
from procedures.report.source import Source

_NAME_OF = {"eye-in-hand": "T_flange_camera", "eye-to-hand": "T_base_camera"}


@dataclass
class HandEyeSource(Source[HandEyeResult]):
    """A hand-eye result; its data set is a capture."""

    @property
    def setup(self) -> str:
        if self.found is not None:
            return self.found.inputs.setup
        return str(getattr(self.result.made_from(), "setup", "eye-in-hand"))

    @property
    def name(self) -> str:
        """The field of X: ``T_flange_camera`` or ``T_base_camera``."""
        return _NAME_OF[self.setup]

    @property
    def parent(self) -> str:
        """The frame that the camera is given in."""
        return axes_frame("eye-in-hand" if self.setup == "eye-in-hand" else "eye-to-hand")

    @property
    def target_parent(self) -> str:
        """The frame that the target rests in."""
        return "base" if self.setup == "eye-in-hand" else "flange"

    @property
    def X(self) -> Array | None:
        """The answer (4, 4)."""
        pose = None if self.found is None else self.found.result.pose()
        return None if pose is None else matrix4(pose[1])

    @property
    def targets(self) -> dict[int, Array]:
        """The pose (4, 4) of the target in each placement."""
        poses = {} if self.found is None else self.found.result.targets()
        matrices = ((int(group), matrix4(pose)) for group, pose in poses.items())
        return {group: T for group, T in matrices if T is not None}

    @property
    def rejected(self) -> dict[int, str]:
        """Index and reason of each observation that was not used."""
        if self.found is None:
            return {int(r["index"]): str(r["reason"]) for r in self.known("unusable") or []}
        return {r.index: r.reason for r in self.found.result.rejected}

    @property
    def before(self) -> tuple[str, Array] | None:
        """Where the pose in effect before this run came from, and that pose (4, 4)."""
        values = self.run.get("values")
        T = matrix4(dig(values, "calibration", self.setup, "X"))
        version = dig(values, "versions", self.name)
        if T is not None:
            return ("the configured pose" if version is None else f"version {version}"), T
        T = matrix4(dig(values, "configured", self.name))
        return None if T is None else ("the configured pose", T)

    @cached_property
    def measured(self) -> MeasuredPoses | None:
        """What the capture shows; None, with a line in ``missing``, when it cannot be read."""
        if self.data is None:
            self.missing.append("No data set is at hand, so the poses cannot be drawn.")
            return None
        try:
            return measure(self.data, None if self.found is None else self.found.result)
        except CellError as exc:
            self.missing.append(f"The data set cannot be read: {exc}")
            return None
