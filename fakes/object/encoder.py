"""The belt's encoder of the object face: the driver's Protocol attached straight to the world."""

from typing import Any

from pydantic import Field

from cell.clock import Clock
from cell.devices import Encoder, EncoderState, Identity
from cell.errors import error
from cell.formats.reading import Strict
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.registry import cell_of

_DT_S = 2e-4


class ObjectEncoderConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectEncoder"``."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    expect_serial: str | None = None
    delay_s: float = Field(default=0.001, ge=0, le=0.1, description="from a position to its being readable")
    time_offset_s: float = Field(
        default=0.0,
        ge=-0.1,
        le=0.1,
        description="Subtracted from every stamp, s: positive when stamps are late",
    )
    lost_after_s: float = Field(default=0.25, gt=0, le=10)


class ObjectEncoder(ObjectDevice):
    """``cell.devices.Encoder`` on virtual time; range and period are those of the scenario's belt."""

    Config = ObjectEncoderConfig
    PLAYS = (Encoder,)

    def __init__(self, name: str, config: ObjectEncoderConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        self.encoder_plant = self._cell.encoder
        super().__init__(name, clock, self.encoder_plant, config.lost_after_s)
        self.config, self.world = config, self._cell.world
        self._encoder = self.encoder_plant.encoder
        self.modulus = self._encoder.modulus
        self.period_s = self._encoder.truth.period_s
        self.counts: LazyStream[EncoderState] = LazyStream(
            f"{name}.counts",
            clock,
            self.period_s,
            self._read,
            dt=_DT_S,
            # No position is readable before it is true, whatever its stamp.
            delay_s=config.delay_s + config.time_offset_s + max(-self._encoder.truth.late_s, 0.0),
            keep=16384,
        )
        self.stream = self.counts
        self._count = 0
        self._before: tuple[int, float, int] | None = None  # epoch, when, position

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while nothing answers on the bus."""
        await super().open()
        self._cell.start()

    async def identify(self) -> Identity:
        """Which encoder this is; ``DEVICE_IDENTITY`` when the config expects another serial."""
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)
        serial, expected = self.encoder_plant.serial, self.config.expect_serial
        if expected is not None and serial != expected:
            raise error("DEVICE_IDENTITY", f"{self.name} has serial {serial}, expected {expected}")
        return Identity("CiA 406 multi-turn encoder", serial)

    def health(self) -> dict[str, Any]:
        """As every device's, with the encoder's emergency in words."""
        return super().health() | {"emergency": self.encoder_plant.emergency}

    def inject(self, kind: str, **arguments: object) -> None:
        """Begin a fault of the belt, the encoder or its bus, by its name in the vocabulary."""
        self.encoder_plant.inject(kind, arguments)

    def _read(self, t: float, tick: int) -> EncoderState:
        t += self.config.time_offset_s
        position = self._encoder.position(self._encoder.told(t))
        if self._before is None or self._before[0] != self.counts.epoch:
            self._count = 0
        else:
            _, before, last = self._before
            step = position - last
            if t - before < 2.5 * self.period_s:  # as a driver sees it, which knows the position only
                half = self.modulus // 2
                step = (step + half) % self.modulus - half
            self._count += step
        self._before = self.counts.epoch, t, position
        return EncoderState(self._count, position % self.modulus)
