"""The observed arm of the object face: the driver's Protocol attached straight to the world."""

import numpy as np
from pydantic import Field

from cell.clock import Clock
from cell.devices import Identity, JointState, ObservedArm
from cell.errors import error
from cell.formats.reading import Strict
from cell.poses import Array
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.registry import cell_of

_LOOKS = 5  # at the joints within the window that decides about rest


class ObjectObservedArmConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectObservedArm"``."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    expect_serial: str | None = None
    poll_period_s: float = Field(default=0.05, ge=0.005, le=5.0)
    reply_s: float = Field(default=0.002, ge=0, le=0.1, description="from request to reply")
    rest_window_s: float = Field(default=0.5, gt=0, le=30.0)
    rest_spread_rad: float = Field(default=1e-4, gt=0, le=0.1)
    handshake: bool = Field(default=True, description="the arm's program takes requests and says where it is")
    allow_requests: bool = Field(default=False, description="without it nothing is ever asked of the arm")
    lost_after_s: float = Field(default=0.5, gt=0, le=5)


class ObjectObservedArm(ObjectDevice):
    """``cell.devices.ObservedArm`` on virtual time."""

    Config = ObjectObservedArmConfig
    PLAYS = (ObservedArm,)

    def __init__(self, name: str, config: ObjectObservedArmConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        self.observed_plant = self._cell.observed
        super().__init__(name, clock, self.observed_plant, config.lost_after_s)
        self.config, self.world = config, self._cell.world
        self._arm = self.observed_plant.arm
        self.axes = self._arm.axes
        self.period_s: float | None = config.poll_period_s
        half_s = config.reply_s / 2.0
        self.joints: LazyStream[JointState] = LazyStream(
            f"{name}.joints", clock, config.poll_period_s, self._poll, dt=half_s, delay_s=half_s
        )
        self.stream = self.joints
        self._opened = 0.0

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the controller refuses."""
        await super().open()
        self._opened = self.clock.now()
        self._cell.start()

    async def identify(self) -> Identity:
        """Which arm this is; ``DEVICE_IDENTITY`` when the config expects another serial."""
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)
        serial, expected = self.observed_plant.serial, self.config.expect_serial
        if expected is not None and serial != expected:
            raise error("DEVICE_IDENTITY", f"{self.name} has serial {serial}, expected {expected}")
        return Identity(self._arm.truth.model, serial, self._arm.truth.version)

    async def request(self, number: int, q: Array) -> bool:
        """Offer a pose to the arm's program; False when it takes none, or the config allows no requests."""
        if not (self.config.handshake and self.config.allow_requests):
            return False
        await self.clock.sleep(2.0 * self.config.reply_s)
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)
        self.observed_plant.settle_past()
        self._arm.request(self.clock.now(), number, q)
        return True

    def inject(self, kind: str, **arguments: object) -> None:
        """Begin a fault of the arm, its program or its link, by its name in the vocabulary."""
        self.observed_plant.inject(kind, arguments)

    def _poll(self, t: float, tick: int) -> JointState:
        q = self._arm.joints(t)
        window = self.config.rest_window_s
        begin = t - window
        at_rest = begin >= self._opened and not self._arm.moving(t)
        if at_rest:
            looks = np.array([self._arm.joints(begin + window * i / _LOOKS) for i in range(_LOOKS)])
            at_rest = bool(np.max(np.ptp(np.vstack([looks, q]), axis=0)) <= self.config.rest_spread_rad)
        number = self._arm.reached(t) if self.config.handshake else 0
        return JointState(q, at_rest, number or None)
