"""What the sections of a hand-eye report ask for: X, the targets, the pose before, the poses measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from calibration.hand_eye.observability import axes_frame
from cell.errors import CellError
from cell.poses import Array
from procedures.hand_eye.report.measured import Measured, measure
from procedures.report.numbers import dig, matrix4
from procedures.report.source import Source

_NAME_OF = {"eye-in-hand": "T_flange_camera", "eye-to-hand": "T_base_camera"}
_TARGET_OF = {"eye-in-hand": "T_base_target", "eye-to-hand": "T_flange_target"}


@dataclass
class HandEyeSource(Source):
    """A hand-eye result; its data set is a capture."""

    @property
    def setup(self) -> str:
        stated = dig(self.result, "inputs", "setup")
        if stated in _NAME_OF:
            return str(stated)
        return "eye-to-hand" if dig(self.answer, "T_base_camera") is not None else "eye-in-hand"

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
        return matrix4(dig(self.answer, self.name))

    @property
    def targets(self) -> dict[int, Array]:
        """The pose (4, 4) of the target in each placement."""
        found = dig(self.answer, _TARGET_OF[self.setup])
        poses = found.items() if isinstance(found, Mapping) else ()
        matrices = ((int(group), matrix4(pose)) for group, pose in poses if str(group).lstrip("-").isdigit())
        return {group: T for group, T in matrices if T is not None}

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
    def measured(self) -> Measured | None:
        """What the capture shows; None, with a line in ``missing``, when it cannot be read."""
        if self.data is None:
            self.missing.append("No data set is at hand, so the poses cannot be drawn.")
            return None
        try:
            return measure(self.data, self.result)
        except CellError as exc:
            self.missing.append(f"The data set cannot be read: {exc}")
            return None
