"""The digital inputs of the object face: the driver's Protocol attached straight to the world."""

from pydantic import Field

from cell.clock import Clock
from cell.devices import DigitalInputs, Identity, InputsState
from cell.errors import error
from cell.formats.reading import Strict
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.registry import cell_of
from fakes.world.beams.input_module import Image

_NOTHING_READ = None, InputsState((), ())
_HALF_RANGE = 1 << 31  # a counter that went on by more was set, not wrapped


class ObjectInputsConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectInputs"``; the scenario names its inputs."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    expect_serial: str | None = None
    poll_period_s: float = Field(default=0.005, ge=0.001, le=1.0)
    reply_s: float = Field(
        default=0.0005, ge=0, le=0.02, description="from request to reply; the module looks some time between"
    )
    time_offset_s: float = Field(
        default=0.0,
        ge=-0.5,
        le=0.5,
        description="Subtracted from every stamp, s: positive when stamps are late",
    )
    lost_after_s: float = Field(default=0.1, gt=0, le=5)


class ObjectInputs(ObjectDevice):
    """``cell.devices.DigitalInputs`` on virtual time; a level is true while its beam is broken."""

    Config = ObjectInputsConfig
    PLAYS = (DigitalInputs,)

    def __init__(self, name: str, config: ObjectInputsConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        self.input_plant = self._cell.inputs
        super().__init__(name, clock, self.input_plant, config.lost_after_s)
        self.config, self.world = config, self._cell.world
        self._module = self.input_plant.inputs
        truth = self._module.truth
        self.names: tuple[str, ...] = tuple(truth.inputs)
        self._channels = tuple(truth.inputs.values())
        self._inverted = tuple(beam in truth.inverted for beam in self.names)
        self._half_s = min(config.reply_s, config.poll_period_s) / 2.0
        self.inputs: LazyStream[InputsState] = LazyStream(
            f"{name}.inputs",
            clock,
            config.poll_period_s,
            self._poll,
            dt=self._half_s,
            delay_s=self._half_s + config.time_offset_s,
            keep=16384,
        )
        self.stream = self.inputs
        self._before: tuple[tuple[bool, ...], tuple[int, ...]] | None = None
        self._changes = (0,) * len(self.names)
        self._last: tuple[Image | None, InputsState] = _NOTHING_READ

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the module refuses."""
        self._before, self._changes, self._last = None, (0,) * len(self.names), _NOTHING_READ
        await super().open()
        self._cell.start()

    async def identify(self) -> Identity:
        """Which module this is; ``DEVICE_IDENTITY`` when the config expects another serial."""
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)
        serial, expected = self.input_plant.serial, self.config.expect_serial
        if expected is not None and serial != expected:
            raise error("DEVICE_IDENTITY", f"{self.name} has serial {serial}, expected {expected}")
        return Identity(self._module.truth.module, serial)

    def inject(self, kind: str, **arguments: object) -> None:
        """Begin a fault of the module, its inputs or its link, by its name in the vocabulary."""
        self.input_plant.inject(kind, arguments)

    def _poll(self, t: float, tick: int) -> InputsState:
        image = self._module.image(t + self.config.time_offset_s + self._half_s * _between(tick))
        if image is self._last[0] or image == self._last[0]:
            return self._last[1]
        levels, counts = image
        now = tuple([levels[k] for k in self._channels]), tuple([counts[k] for k in self._channels if counts])
        if self._before is not None:
            self._changes = tuple(
                changes + self._changed(i, self._before, now) for i, changes in enumerate(self._changes)
            )
        self._before = now
        logical = tuple([level != off for level, off in zip(now[0], self._inverted, strict=True)])
        state = InputsState(logical, self._changes)
        self._last = image, state
        return state

    @staticmethod
    def _changed(
        i: int,
        before: tuple[tuple[bool, ...], tuple[int, ...]],
        now: tuple[tuple[bool, ...], tuple[int, ...]],
    ) -> int:
        """Changes of input ``i`` between two polls, pulses included that its counter alone has seen."""
        moved = now[0][i] != before[0][i]
        if not now[1]:
            return int(moved)
        rising = (now[1][i] - before[1][i]) % (2 * _HALF_RANGE)
        if rising >= _HALF_RANGE:
            return int(moved)
        return max(2 * rising + (before[0][i] - now[0][i]), int(moved))


def _between(tick: int) -> float:
    """Some number in -1 .. 1 that is always the same for a tick."""
    return (tick * 2654435761 % (1 << 32)) / (1 << 31) - 1.0
