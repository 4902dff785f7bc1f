"""The tables of a scenario that describe a tool's shape, light beams across the cell, and the module that
reads them."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from cell.formats.reading import Strict

Three = Annotated[list[float], Field(min_length=3, max_length=3)]
Seconds = Annotated[float, Field(ge=0, le=1)]
Channel = Annotated[int, Field(ge=0)]

CHANNELS = {"generic": 16, "ioLogik-E1210": 16, "ADAM-6050": 12, "WAGO-750": 16}


class CapsuleTruth(Strict):
    """A cylinder with round ends: all points within ``radius_m`` of the line ``from`` .. ``to``."""

    from_: Three = Field(alias="from", description="one end of the axis, m, in the tool frame")
    to: Three = Field(description="the other end, m, in the tool frame")
    radius_m: float = Field(gt=0, le=0.5)


class BeamTruth(Strict):
    """A light beam and its sensor; ``point`` (m) is the middle of the beam, ``dir`` its way, in the base."""

    point: Three
    dir: Three
    length_m: float = Field(default=0.3, gt=0, le=10)
    radius_m: float = Field(default=0.0005, gt=0, le=0.05)
    latency_s: Seconds = Field(default=0.0005, description="from the light to the sensor's output")
    hysteresis_m: float = Field(
        default=0.0, ge=0, le=0.01, description="distance at which it clears less the one at which it breaks"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not np.linalg.norm(self.dir) > 0:
            raise ValueError("dir has no length")
        return self


class IoTruth(Strict):
    """``[world.io]``: the input module. What it shows lags the sensors by its filter and its scan."""

    serial: str = Field(
        default="99993300001", pattern=r"^9999\d+$", description="twin serials begin with 9999"
    )
    module: Literal["generic", "ioLogik-E1210", "ADAM-6050", "WAGO-750"] = "generic"
    inputs: dict[str, Channel] = Field(default={}, description="channel of each beam")
    inverted: list[str] = Field(default=[], description="beams whose sensor is on while the beam is free")
    scan_s: Seconds = Field(default=0.0, description="the module looks once in this time; 0: always")
    filter_s: Seconds = Field(default=0.0, description="a level counts once it has lasted so long")
    bounce_s: Seconds = Field(default=0.0, description="contacts bounce so long at every edge")
    counters: bool = Field(default=False, description="it counts rising edges of every channel")

    @model_validator(mode="after")
    def _channels_exist_once(self) -> Self:
        channels = list(self.inputs.values())
        if len(set(channels)) != len(channels):
            raise ValueError("inputs has two beams on one channel")
        most = CHANNELS[self.module]
        if any(channel >= most for channel in channels):
            raise ValueError(f"{self.module} has the channels 0..{most - 1}")
        strange = sorted(set(self.inverted) - set(self.inputs))
        if strange:
            raise ValueError(f"inverted names {', '.join(strange)}, which is not among its inputs")
        return self
