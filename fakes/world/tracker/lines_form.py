"""How a tracker's point is written as a line of text."""

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from cell.formats.reading import Strict
from fakes.world.tracker.tracker import Reading
from fakes.world.tracker.truth import TrackerTruth

_LENGTHS = {"m": 1.0, "mm": 1e3, "in": 1.0 / 0.0254}
_ANGLES = {"rad": 1.0, "deg": 180.0 / math.pi, "gon": 200.0 / math.pi}


class LinesForm(Strict):
    """``[fakes.tracker_lines]``: what a line says, when it comes, and which reflector is followed."""

    port: int = Field(default=5012, ge=1024, le=65535)
    text: str = Field(
        default="{n},{t:.3f},{x:.4f},{y:.4f},{z:.4f},{valid}\r\n",
        description="Python's format of n, t (s), x, y, z, hz, v, range, valid, status, serial, temperature_c"
        " and pressure_pa",
    )
    heading: str = Field(default="", description="what a client gets first")
    length_unit: Literal["m", "mm", "in"] = "mm"
    angle_unit: Literal["rad", "deg", "gon"] = "deg"
    valid: str = "1"
    invalid: str = "0"
    period_s: float = Field(default=0.05, ge=0.001, le=10)
    request: str | None = Field(
        default=None, min_length=1, description="a line is sent for each of these; else at every period"
    )
    reflector: str = Field(description="the one that its operator has locked at first")
    relock_s: float = Field(default=1.0, gt=0, le=60, description="it searches for a lost one so often")

    @model_validator(mode="after")
    def _can_be_written(self) -> Self:
        try:
            self.line(0, 0.0, Reading(0.0, 0.0, 0.0, None, "", False))
        except (KeyError, ValueError, IndexError) as exc:
            raise ValueError(f"text cannot be formatted: {exc!r}") from exc
        return self

    def line(self, n: int, t: float, reading: Reading, truth: TrackerTruth | None = None) -> bytes:
        """The line of a reading, the ``n``-th, ``t`` seconds after the first."""
        length, angle = _LENGTHS[self.length_unit], _ANGLES[self.angle_unit]
        x, y, z = (0.0, 0.0, 0.0) if reading.point is None else (length * reading.point).tolist()
        text = self.text.format(
            n=n,
            t=t,
            x=x,
            y=y,
            z=z,
            hz=angle * reading.hz,
            v=angle * reading.v,
            range=length * reading.slope,
            valid=self.invalid if reading.point is None else self.valid,
            status=reading.status,
            serial="" if truth is None else truth.serial,
            temperature_c=0.0 if truth is None else truth.temperature_c,
            pressure_pa=0.0 if truth is None else truth.pressure_pa,
        )
        return text.encode()
