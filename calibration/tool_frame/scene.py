"""What a measurement with two crossed beams consists of, in memory. Metres, seconds; frames as named."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.refusal import Refusal
from calibration.tool_frame.edges import Bracket, brackets
from cell.poses import Array


@dataclass(frozen=True, eq=False)
class Line:
    """A light beam in the base: any point of it, and its unit direction."""

    point: Array
    direction: Array

    @classmethod
    def of(cls, point: Sequence[float], direction: Sequence[float]) -> "Line":
        d = np.array(direction, dtype=float)
        return cls(np.array(point, dtype=float), d / np.linalg.norm(d))


@dataclass(frozen=True, eq=False)
class ReferenceTool:
    """The tool that everything is held against, in the flange.

    ``axis`` is a unit vector from the flange towards the point ``p``; ``radius`` that of the tool where it
    crosses the beams. ``axis_known`` is False where the axis is itself a measurement, and no better than one.
    """

    p: Array
    axis: Array
    radius: float
    axis_known: bool = True

    @classmethod
    def of(cls, p: Sequence[float], axis: Sequence[float], radius: float) -> "ReferenceTool":
        point, a = np.array(p, dtype=float), np.array(axis, dtype=float)
        a = a / np.linalg.norm(a)
        return cls(point, -a if a @ point < 0.0 else a, float(radius))


@dataclass(frozen=True, eq=False)
class Pass:
    """One way across a beam; ``index`` counts within its set, the reference's or the current one.

    ``pose_xyz`` (n, 3) is the flange in the base at ``pose_t`` (n,); ``poll_v`` (m,) says whether the beam
    was broken at ``poll_t`` (m,), ``poll_n`` counts its changes, ``poll_dt`` is how far each poll's
    time may be off.
    """

    index: int
    current: bool
    beam: str
    direction: int
    pose_t: Array
    pose_xyz: Array
    poll_t: Array
    poll_v: NDArray[np.bool_]
    poll_n: NDArray[np.int64] | None = None
    poll_dt: Array | None = None

    @cached_property
    def edges(self) -> list[Bracket]:
        """The changes that the polls saw, oldest first."""
        return brackets(self.poll_t, self.poll_v, self.poll_n, self.poll_dt)

    @cached_property
    def middle(self) -> Array:
        """(3,) m the flange in the base in the mean."""
        found: Array = np.mean(self.pose_xyz, axis=0)
        return found

    @property
    def name(self) -> str:
        return f"{'current' if self.current else 'reference'} pass {self.index} (beam {self.beam})"


@dataclass(frozen=True, eq=False)
class ToolFrameScene:
    """All passes in one attitude ``R`` = R_base_flange (3, 3). ``repeatability_m`` is the standard
    deviation of one axis by the arm's data sheet, None when the arm is not known."""

    R: Array
    beams: Mapping[str, Line]
    tool: ReferenceTool
    passes: Sequence[Pass]
    repeatability_m: float | None = None
    # What was seen of a pass at a delay: a scene and its parts are solved many times.
    seen: dict[tuple[Pass, float], Any] = field(default_factory=dict, init=False, repr=False)

    def take(self, keep: Sequence[int]) -> "ToolFrameScene":
        """Only the passes at the places ``keep`` of the list."""
        part = ToolFrameScene(
            self.R, self.beams, self.tool, [self.passes[k] for k in keep], self.repeatability_m
        )
        object.__setattr__(part, "seen", self.seen)
        return part


class Refused(Exception):
    """The data cannot determine the answer; ``refusal`` says why."""

    def __init__(self, name: str, words: str) -> None:
        self.refusal = Refusal(name, words)
        super().__init__(str(self.refusal))
