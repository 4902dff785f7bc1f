"""The input of the object face that tells whether the place is clear where items are put down."""

from pydantic import Field

from cell.clock import Clock
from cell.devices import DigitalInputs, Identity, InputsState
from cell.errors import error
from cell.formats.reading import Strict
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.registry import cell_of


class ObjectPlaceInputsConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectPlaceInputs"``; the scenario names its input."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    poll_period_s: float = Field(default=0.01, ge=0.001, le=1.0)
    lost_after_s: float = Field(default=0.5, gt=0, le=5)


class ObjectPlaceInputs(ObjectDevice):
    """``cell.devices.DigitalInputs`` on virtual time, with the one input of ``[world.place]``."""

    Config = ObjectPlaceInputsConfig
    PLAYS = (DigitalInputs,)

    def __init__(self, name: str, config: ObjectPlaceInputsConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        plant = self._cell.plant("place_inputs")
        super().__init__(name, clock, plant, config.lost_after_s)
        place = self._cell.world.place
        if place is None:
            raise error("CONFIG_INVALID", "the scenario has no [world.place]")
        self._place = place
        self.names: tuple[str, ...] = (place.truth.input,)
        self.inputs: LazyStream[InputsState] = LazyStream(
            f"{name}.inputs", clock, config.poll_period_s, self._poll, dt=0.0
        )
        self.stream = self.inputs
        self._level, self._changes = False, 0

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the module refuses."""
        self._changes = 0
        await super().open()
        self._cell.start()

    async def identify(self) -> Identity:
        """Its own serial."""
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)
        return Identity("object-place-inputs", self.plant.serial)

    def _poll(self, t: float, tick: int) -> InputsState:
        level = self._place.is_clear(t)
        if tick:
            self._changes += level is not self._level
        self._level = level
        return InputsState((level,), (self._changes,))
