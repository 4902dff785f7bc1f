"""``[world.belt]``: how a belt runs, and the encoder on its shaft."""

from math import inf
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from cell.formats.reading import Strict
from fakes.world.beams.truth import Three

Range = tuple[float, float]
MAX_U32 = 0xFFFF_FFFF


class PhaseTruth(Strict):
    """The belt goes to ``speed_m_s`` and keeps it for ``for_s``; the first phase has its speed at once."""

    speed_m_s: float = Field(ge=-3, le=3, description="negative runs against dir, 0 stands")
    accel_m_s2: float = Field(default=0.6, gt=0, le=50)
    creep_per_s: float = Field(
        default=0.0, ge=-0.05, le=0.05, description="share of the speed by which it grows each second"
    )
    for_s: float | None = Field(default=None, gt=0, le=1e6, description="absent: for ever")


class StopsTruth(Strict):
    """Stops at random: each number is drawn between the two given, anew every time."""

    every_s: Range = (1.0, 3.0)
    held_s: Range = (0.2, 1.0)
    accel_m_s2: Range = (0.3, 1.2)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for name in ("every_s", "held_s", "accel_m_s2"):
            low, high = getattr(self, name)
            if not 0 < low <= high < inf:
                raise ValueError(f"{name} = [{low:g}, {high:g}] should be two positive numbers in order")
        return self


class RippleTruth(Strict):
    """The speed is multiplied by 1 + amplitude sin(2 pi hz t + phase_rad)."""

    amplitude: float = Field(ge=0, le=0.2)
    hz: float = Field(gt=0, le=50)
    phase_rad: float = 0.0


class BeltTruth(Strict):
    """The belt in the base, its motion, and its encoder's scale, range and identity."""

    serial: str = Field(
        default="999966001",
        pattern=r"^9999\d+$",
        description="twin serials begin with 9999; CANopen's has 32 bits, so 4294967295 is the largest",
    )
    node: int = Field(default=5, ge=1, le=127, description="CANopen node number")
    m_per_count: float = Field(
        default=1e-4, ge=-0.1, le=0.1, description="belt travel per count; negative: counts go down"
    )
    modulus: int = Field(default=65536, ge=16, le=MAX_U32, description="the encoder's own range")
    count_at_start: int = Field(default=1000, ge=0, le=MAX_U32)
    period_s: float = Field(default=0.005, ge=0.001, le=1.0, description="between position messages")
    late_s: float = Field(
        default=0.0,
        ge=-0.2,
        le=0.2,
        description="a position is older than its message by this at least; negative: of a cell whose arm "
        "stamps later still",
    )
    jitter_s: float = Field(
        default=0.0, ge=0, le=0.02, description="and by up to this more, as chance has it"
    )
    by_events: bool = Field(
        default=False,
        description="a new position is told at once, as often as the inhibit time allows (CANopen); on "
        "virtual time positions come by period_s",
    )
    keeps_position: bool = Field(default=True, description="after a restart; an incremental one begins at 0")
    origin: Three = Field(default=[0.0, -0.5, 0.2])
    dir: Three = Field(default=[1.0, 0.0, 0.0], description="the way of positive travel, in the base")
    profile: list[PhaseTruth] = Field(default=[PhaseTruth(speed_m_s=0.15)], min_length=1)
    repeat: bool = Field(default=False, description="begin the profile again at its end")
    stops: StopsTruth | None = None
    ripple: list[RippleTruth] = Field(default=[])

    @model_validator(mode="after")
    def _creeps_end(self) -> Self:
        if any(phase.creep_per_s and phase.for_s is None for phase in self.profile):
            raise ValueError("a phase with creep_per_s needs for_s: the speed would grow for ever")
        return self

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if int(self.serial) > MAX_U32:
            raise ValueError(f"serial {self.serial} does not fit the 32 bits of a CANopen serial number")
        if self.m_per_count == 0.0:
            raise ValueError("m_per_count is 0; a belt that moves counts")
        if not np.linalg.norm(self.dir) > 0:
            raise ValueError("dir has no length")
        endless = [k for k, phase in enumerate(self.profile) if phase.for_s is None]
        if endless and (self.repeat or endless[0] < len(self.profile) - 1):
            raise ValueError("a phase without for_s never ends: it must be the last one, and not repeated")
        if sum(ripple.amplitude for ripple in self.ripple) >= 1.0:
            raise ValueError("the ripples together would turn the belt around")
        return self
