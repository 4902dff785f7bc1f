"""The tables of a scenario that describe a laser tracker and the reflectors that it can measure."""

from math import inf
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from cell.formats.reading import Strict
from cell.laser_tracker import MOST_SIGMA0_M, MOST_SIGMA_PER_M
from fakes.world.beams.truth import Three

Six = Annotated[list[float], Field(min_length=6, max_length=6)]
Two = Annotated[list[float], Field(min_length=2, max_length=2)]


class ReflectorTruth(Strict):
    """A reflector's centre in what carries it, and from where light comes back from it.

    ``point`` (m) and ``normal`` are in the flange of the arm or of the observed arm, or in the base.
    """

    on: Literal["arm", "observed", "base"]
    point: Three
    normal: Three | None = Field(default=None, description="where it looks; without it, everywhere")
    half_angle_rad: float = Field(
        default=0.52, gt=0, le=np.pi, description="cone about normal that it accepts"
    )
    constant_m: float = Field(default=0.0, ge=-0.1, le=0.1, description="true additive constant")
    constant_nominal_m: float | None = Field(
        default=None, ge=-0.1, le=0.1, description="what its label says; without it, the truth"
    )

    @property
    def labelled_constant_m(self) -> float:
        return self.constant_m if self.constant_nominal_m is None else self.constant_nominal_m

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        if self.normal is not None and not np.linalg.norm(self.normal) > 0:
            raise ValueError("normal has no length")
        return self


class BoxTruth(Strict):
    """A box along the axes of the base, m."""

    min: Three
    max: Three

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        if not all(low < high for low, high in zip(self.min, self.max, strict=True)):
            raise ValueError("min is not below max along every axis")
        return self


class TrackerTruth(Strict):
    """``[world.tracker]``: the instrument on its stand.

    The tracker frame is right-handed with its origin where the axes meet: x to the instrument's E (Hz = 90
    degrees), y to its N (Hz = 0), z up (V = 0).
    """

    serial: str = Field(
        default="99994400001", pattern=r"^9999\d+$", description="twin serials begin with 9999"
    )
    name: str = "Twin tracker"
    version: str = Field(default="1.2.3", pattern=r"^\d+\.\d+\.\d+$")
    T_base_tracker: Six
    sigma0_m: float = Field(
        default=15e-6, ge=0, le=MOST_SIGMA0_M, description="noise of a reading along one axis"
    )
    sigma_per_m: float = Field(
        default=6e-6, ge=0, le=MOST_SIGMA_PER_M, description="and what each metre of range adds"
    )
    drift_m_h: Three = Field(default=[0.0] * 3, description="how the stand creeps, base frame, m/h")
    drift_rad_h: Three = Field(default=[0.0] * 3, description="and turns about the instrument, rad/h")
    rate_hz: float = Field(default=50.0, ge=1, le=1000, description="readings while it follows a reflector")
    range_m: Two = Field(default=[0.3, 40.0])
    elevation_rad: Two = Field(default=[-0.9, 1.4])
    search_rad: float = Field(default=0.05, gt=0, le=0.8, description="half the window that a search covers")
    separable_rad: float = Field(
        default=0.002, ge=0, le=0.5, description="two reflectors closer to each other are too much for it"
    )
    turn_rad_s: float = Field(default=3.0, gt=0, le=20)
    search_s: float = Field(default=0.5, ge=0, le=10)
    aim_rad: float = Field(default=0.001, gt=0, le=0.1, description="how far off its aim it still measures")
    measure_s: float = Field(default=0.05, ge=0, le=10, description="one distance")
    one_by_one: bool = Field(
        default=False, description="object face: a point's readings are such distances; else those of rate_hz"
    )
    constant_m: float = Field(default=0.0, ge=-0.1, le=0.1, description="reflector constant it is set to")
    temperature_c: float = Field(default=20.0, ge=-40, le=60)
    pressure_pa: float = Field(default=101325.0, ge=50e3, le=120e3)
    arm_radius_m: float = Field(
        default=0.0, ge=0, le=0.3, description="of the links, which hide what is behind them; 0: they do not"
    )
    opaque: list[BoxTruth] = Field(default=[], description="what hides the reflectors behind it")

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        for name in ("range_m", "elevation_rad"):
            low, high = getattr(self, name)
            if not -inf < low < high < inf:
                raise ValueError(f"{name} is [low, high]; {low:g} is not below {high:g}")
        return self
