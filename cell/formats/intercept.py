"""``cellward.intercept/1``: counts of a belt, sightings of items on it, and questions where they will be.

Read beyond the format: ``modulus`` may be null or absent for a counter that does not wrap, and ``camera``
says what the items were placed with.
"""

from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from cell.errors import present
from cell.formats.bounds import (
    COUNTS,
    QUERIES,
    SAMPLES,
    SMALLEST_M,
    AtMost,
    Length,
    Pose,
    Ratio,
    Stamp,
    Whole,
)
from cell.formats.capture import Camera
from cell.formats.reading import Strict

SCHEMA = "cellward.intercept/1"

Len14 = Field(min_length=14, max_length=14)
NotNegative = Annotated[float, Field(ge=0.0)]
Id = Whole | Annotated[str, Field(max_length=1000)]
Duration = Annotated[NotNegative, AtMost(10.0, "s")]
TRAVEL_M = (1e-9, 0.02)  # of one count


class Belt(Strict):
    """The encoder's scale (given, or by wheel and resolution), the belt's direction in base, the range."""

    m_per_count: float | None = None
    wheel_circumference_m: Annotated[float, Field(ge=SMALLEST_M, le=100.0)] | None = None
    counts_per_revolution: Annotated[float, Field(ge=1e-3, le=1e12)] | None = None
    dir: Annotated[list[Ratio], Field(min_length=2, max_length=3)]
    modulus: Annotated[int, Field(ge=2, le=2**64)] | None = None
    period: Annotated[float, Field(ge=1e-6), AtMost(10.0, "s")]
    notes: Any = None

    @field_validator("dir")
    @classmethod
    def _dir_points_somewhere(cls, v: list[float]) -> list[float]:
        if v[0] ** 2 + v[1] ** 2 <= 0.25 * sum(x * x for x in v):
            raise ValueError("must be a direction in base with a horizontal part, such as [1, 0, 0]")
        return v

    @model_validator(mode="after")
    def _scale_is_given_once(self) -> "Belt":
        by_wheel = self._by_wheel
        if self.m_per_count is None and by_wheel is None:
            raise ValueError("needs m_per_count, or wheel_circumference_m and counts_per_revolution; add it")
        if self.m_per_count == 0.0:
            raise ValueError("has m_per_count 0; it is the travel in metres of one count")
        given = abs(self.scale)
        if by_wheel is not None and abs(given - by_wheel) > 1e-3 * by_wheel:
            raise ValueError(f"has m_per_count and a wheel that gives {by_wheel:.6g}; keep the right one")
        if not TRAVEL_M[0] <= given <= TRAVEL_M[1]:
            raise ValueError(f"moves {self.scale:g} m with one count, which no belt does; give it in metres")
        return self

    @property
    def scale(self) -> float:
        """Metres per count."""
        return present(self._by_wheel if self.m_per_count is None else self.m_per_count, "scale of the belt")

    @property
    def _by_wheel(self) -> float | None:
        """Metres per count; None without a wheel and its resolution."""
        if self.wheel_circumference_m is None or self.counts_per_revolution is None:
            return None
        return self.wheel_circumference_m / self.counts_per_revolution


class Limits(Strict):
    """Of each axis: m/s, m/s^2, m/s^3."""

    v: Annotated[float, Field(ge=1e-6), AtMost(100.0, "m/s")]
    a: Annotated[float, Field(ge=1e-6), AtMost(1e5, "m/s^2")]
    j: Annotated[float, Field(ge=1e-6), AtMost(1e8, "m/s^3")]


class PickingArm(Strict):
    """Where the arm waits (base, m) and how fast it moves; ``above`` is its height over the item (m)."""

    limits: Limits
    wait_point: Annotated[list[Length], Field(min_length=2, max_length=3)]
    above: Annotated[NotNegative, AtMost(10.0, "m")]
    notes: Any = None


class Detection(Strict):
    """One sighting: exposed at ``t_exp`` (null: unknown), arrived at ``t_recv``; base, m. ``sigma`` is what
    the detector states of its place, along the worse axis; null: nothing."""

    id: Id
    t_recv: Stamp
    t_exp: Stamp | None = None
    xy: Annotated[list[Length], Field(min_length=2, max_length=2)]
    z: Length = 0.0
    sigma: Annotated[float, Field(ge=0)] | None = None
    notes: Any = None


class ItemsCamera(Strict):
    """The camera that saw the items, as it ``told`` itself; ``lens``: of the calibration of its pose, which
    places are made with, null where they are made with the one that it told. ``cov``: of pose (6, in the
    camera's axes) and lens (8) together, null where it is not known."""

    T_base_camera: Pose
    told: Camera
    lens: Camera | None = None
    cov: Annotated[list[Annotated[list[float], Len14]], Len14] | None = None


class Query(Strict):
    """Where will item ``id`` be at ``t + h`` for each of ``horizons`` (s), asked at ``t``?"""

    id: Id
    t: Stamp
    horizons: Annotated[list[Annotated[float, Field(ge=0.0, le=60.0)]], Field(max_length=1000)]
    notes: Any = None


class ZoneTable(Strict):
    """Range of ``dot(p, dir)`` in base in which the arm may touch items, m."""

    min: Length | None = None
    max: Length | None = None

    @model_validator(mode="after")
    def _edges_are_in_order(self) -> "ZoneTable":
        if self.min is not None and self.max is not None and self.min >= self.max:
            raise ValueError(f"has min {self.min} not below max {self.max}; swap or correct them")
        return self


class ClassicTable(Strict):
    """Times of the classic method, s."""

    T1_s: Annotated[float, Field(ge=1e-6, le=1e4)] | None = None
    t2_s: Annotated[float, Field(ge=0.0, le=1e4)] | None = None


Count = tuple[Stamp, Annotated[int, Field(ge=-(2**63), lt=2**64)]]


class Intercept(Strict):
    """The whole data set."""

    schema_: Annotated[str, Field(alias="schema")]
    belt: Belt
    robot: PickingArm
    encoder: Annotated[list[Count], Field(max_length=COUNTS)]
    detections: Annotated[list[Detection], Field(max_length=SAMPLES)]
    latency_mean: Duration | None = None
    queries: Annotated[list[Query], Field(max_length=QUERIES)]
    zone: ZoneTable | None = None
    dwell_s: Duration | None = None
    camera: ItemsCamera | None = None
    classic: ClassicTable | None = None
    notes: Any = None

    @model_validator(mode="after")
    def _unknown_exposures_have_a_latency(self) -> "Intercept":
        if self.latency_mean is None:
            for k, d in enumerate(self.detections):
                if d.t_exp is None:
                    raise ValueError(
                        f"has detections[{k}] without t_exp and no latency_mean; add latency_mean in seconds"
                    )
        return self
