"""``cellward.laser/1``: passes of a tool across two light beams, with a reference set and a current one.

Two extensions of the format that runs use: ``poll_n`` is the counter of the input's changes as each poll read
it, so that a pulse between two polls is seen; ``poll_dt`` is half of the time that each poll took. The data
set itself may have ``repeatability_m``, the standard deviation of one axis by the arm's data sheet.
"""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from cell.errors import error
from cell.formats.bounds import SMALLEST_M, Direction, Length, Point, Rotation, Stamp
from cell.formats.reading import Strict, parse

SCHEMA = "cellward.laser/1"
MAX_PASSES = 5000
MAX_SAMPLES = 200_000  # of one pass
_MIN_LENGTH = 1e-9
_Z_OFF_M = 1e-3
# So rare polls along so slow a way are no measurement: the times are in another unit.
_RARE_S, _CRAWL_M_S, _MOVES_M = 0.2, 5e-4, 1e-3

Times = Annotated[list[Stamp], Field(min_length=2, max_length=MAX_SAMPLES)]


def _growing(times: list[float], what: str) -> list[float]:
    t = np.array(times)
    if len(late := np.flatnonzero(np.diff(t) <= 0.0)):
        k = int(late[0]) + 1
        raise ValueError(f"must grow from {what} to {what}; entry {k} is not after entry {k - 1}")
    return times


def _direction(v: list[float]) -> list[float]:
    if float(np.linalg.norm(v)) < _MIN_LENGTH:
        raise ValueError("must be a direction, not zeros")
    return v


class BeamLine(Strict):
    """A beam in the base: any point of it (m), and its direction of any length."""

    point: Point
    dir: Direction

    @field_validator("dir")
    @classmethod
    def _dir_is_a_direction(cls, v: list[float]) -> list[float]:
        return _direction(v)


class BeamPair(Strict):
    """``xs`` runs about along base x and is crossed along y; ``ys`` the other way round."""

    xs: BeamLine
    ys: BeamLine


class ToolEntry(Strict):
    """The tool of the reference in the flange: its point and axis, and its radius where it crosses (m)."""

    id: str | None = None
    p_ref: Point
    axis_ref: Direction
    radius: Annotated[float, Field(ge=SMALLEST_M, le=1.0)]

    @field_validator("axis_ref")
    @classmethod
    def _axis_is_a_direction(cls, v: list[float]) -> list[float]:
        return _direction(v)


class PassEntry(Strict):
    """One way across a beam: the flange in the base, and the polls of the beam's input (1: broken)."""

    beam: Literal["xs", "ys"]
    dir: Literal[1, -1]
    z: Length
    pose_t: Times
    pose_xyz: Annotated[list[Point], Field(min_length=2, max_length=MAX_SAMPLES)]
    poll_t: Times
    poll_v: list[Literal[0, 1]]
    poll_n: list[Annotated[int, Field(ge=0, lt=2**63)]] | None = None
    poll_dt: list[Annotated[float, Field(ge=0.0, le=10.0)]] | None = None
    notes: Any = None

    @field_validator("pose_t")
    @classmethod
    def _poses_are_in_order(cls, v: list[float]) -> list[float]:
        return _growing(v, "pose")

    @field_validator("poll_t")
    @classmethod
    def _polls_are_in_order(cls, v: list[float]) -> list[float]:
        return _growing(v, "poll")

    @model_validator(mode="after")
    def _lists_belong_together(self) -> "PassEntry":
        for times, name in (
            ("pose_t", "pose_xyz"),
            ("poll_t", "poll_v"),
            ("poll_t", "poll_n"),
            ("poll_t", "poll_dt"),
        ):
            values = getattr(self, name)
            if values is not None and len(values) != (wanted := len(getattr(self, times))):
                raise ValueError(f"has {len(values)} entries in {name} and {wanted} in {times}; give as many")
        return self

    @model_validator(mode="after")
    def _height_is_that_of_the_poses(self) -> "PassEntry":
        heights = [p[2] for p in self.pose_xyz]
        low, high = min(heights), max(heights)
        if not low - _Z_OFF_M <= self.z <= high + _Z_OFF_M:
            raise ValueError(
                f"has z {self.z:g} m, and its pose_xyz is at {0.5 * (low + high):g} m; both are the height "
                "of the flange in the base, so give the same"
            )
        return self

    @model_validator(mode="after")
    def _times_are_in_seconds(self) -> "PassEntry":
        gap = float(np.median(np.diff(self.poll_t)))
        way = float(np.linalg.norm(np.ptp(np.array(self.pose_xyz), axis=0)))
        speed = way / (self.pose_t[-1] - self.pose_t[0])
        if gap >= _RARE_S and speed <= _CRAWL_M_S and way >= _MOVES_M:
            raise ValueError(
                f"has polls {gap:g} s apart in poll_t on a way of {1e3 * speed:.3g} mm/s, which looks like "
                "milliseconds; give pose_t and poll_t in seconds"
            )
        return self


class LaserScene(Strict):
    """Passes of one tool in one attitude; missed ones too."""

    passes: Annotated[list[PassEntry], Field(max_length=MAX_PASSES)]
    notes: Any = None


class LaserData(Strict):
    """The whole data set."""

    schema_: Annotated[str, Field(alias="schema")]
    R_base_flange: Rotation
    beams: BeamPair
    tool: ToolEntry
    reference: LaserScene
    current: LaserScene
    repeatability_m: Annotated[float, Field(gt=0.0, le=0.01)] | None = None
    notes: Any = None


def parse_laser(raw: dict[str, Any], where: str, *, current: bool = True) -> LaserData:
    """``raw`` as a data set; ``where`` names the file. Without ``current`` that set may be empty."""
    data = parse(LaserData, raw, SCHEMA, where)
    needed = {"reference": data.reference, **({"current": data.current} if current else {})}
    for name, found in needed.items():
        if not found.passes:
            raise error("DATA_INVALID", f"{where}: {name}.passes is empty; give the passes of that tool")
    return data
