"""A Robotiq gripper with two fingers (2F-85, 2F-140, Hand-E), over Modbus or the socket of its URCap."""

from typing import Any, Self
from urllib.parse import urlsplit

from pydantic import Field, model_validator

from cell.clock import Clock
from cell.devices import Gripper, Identity
from cell.errors import error
from drivers.grippers.polled import PolledConfig, PolledGripper
from drivers.grippers.robotiq_links import ModbusRobotiq, RobotiqLink, UrcapRobotiq
from drivers.grippers.robotiq_words import FAULTS, MINOR_FAULTS, Activation, Fingers, RobotiqState
from drivers.modbus.address import parse_url
from drivers.modbus.link import LinkSettings, ModbusLink, NoAnswer

ACTIVATION_S = 10.0


class RobotiqConfig(PolledConfig):
    """Keys of a device with ``driver = "robotiq"``."""

    url: str = Field(
        description="rtu:///dev/ttyUSB0?baudrate=115200&parity=N&stopbits=1, tcp://host:port of a Modbus"
        " gateway, or urcap://host: the socket of its URCap on the arm's controller (port 63352)"
    )
    unit: int = Field(default=9, ge=0, le=255, description="Modbus unit; the maker's is 9")
    closed: int = Field(default=255, ge=0, le=255, description="Position that grips; 255 is closed")
    open: int = Field(default=0, ge=0, le=255, description="Position that lets go; 0 is open")
    speed: int = Field(default=255, ge=0, le=255, description="Of the fingers; 255 is the fastest")
    force: int = Field(default=128, ge=0, le=255, description="Of the fingers; 255 is the strongest")
    activate: bool = Field(
        default=False,
        description="true: the first grip or release activates a gripper that is not, which moves its fingers"
        " all the way and back; false: that is an error, and it is activated at the pendant",
    )

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if self.is_urcap:
            parts = urlsplit(self.url)
            if not parts.hostname or parts.path.strip("/") or parts.query:
                raise ValueError(f"url '{self.url}' should be urcap://host or urcap://host:port")
        else:
            parse_url(self.url)
        if self.closed == self.open:
            raise ValueError(f"closed and open are both {self.open}: nothing would ever move")
        return self

    @property
    def is_urcap(self) -> bool:
        return self.url.startswith("urcap://")


class RobotiqGripper(PolledGripper[RobotiqState]):
    """``cell.devices.Gripper``. It holds something when its fingers are stopped by it on their way.

    Fingers that get to ``closed`` hold nothing. A thing so thin that they get there all the same cannot be
    told from nothing: give ``closed`` a position beyond it.
    """

    Config = RobotiqConfig
    PLAYS = (Gripper,)

    def __init__(self, name: str, config: RobotiqConfig, clock: Clock) -> None:
        super().__init__(name, config, clock)
        self._config = config
        self._link: RobotiqLink | None = None
        inward = config.closed > config.open
        self._stopped = Fingers.BLOCKED_CLOSING if inward else Fingers.BLOCKED_OPENING

    @property
    def confirms(self) -> bool:
        """True: where its fingers stop tells."""
        return True

    async def grip(self, timeout: float) -> bool:
        """Close; True when something stopped the fingers within ``timeout`` s.

        ``GRIPPER_NOT_ACTIVE``, ``GRIPPER_FAULT``.
        """
        return await self._move(self._config.closed, timeout) is self._stopped

    async def release(self, timeout: float) -> bool:
        """Open; True when the fingers got there within ``timeout`` s. Errors as of :meth:`grip`."""
        return await self._move(self._config.open, timeout) is Fingers.ARRIVED

    # -- inside

    async def _move(self, position: int, timeout: float) -> Fingers:
        """Go there; what ended it, or MOVING when nothing did within ``timeout`` s."""
        config, link = self._config, self._opened(self._link)
        await self._be_active(link)
        try:
            await link.move(position, config.speed, config.force)
        except NoAnswer as exc:
            raise error("CALL_TIMEOUT", f"{self.name} was told to move, and there was {exc}") from exc

        def at_rest(state: RobotiqState) -> bool:
            moved = state.requested == position and state.fingers is not Fingers.MOVING
            return moved or bool(state.fault) or state.activation != Activation.ACTIVE

        if not await self._becomes(at_rest, timeout):
            return Fingers.MOVING
        last = self.states.latest(timeout).value
        self._refuse_fault(last)
        return last.fingers

    async def _be_active(self, link: RobotiqLink) -> None:
        state = self.states.latest(self._config.lost_after_failures * self._config.poll_period_s + 1.0).value
        self._refuse_fault(state)
        if state.activation == Activation.ACTIVE:
            return
        if not self._config.activate:
            raise error("GRIPPER_NOT_ACTIVE", f"{self.name}: gSTA is {state.activation}, and 3 is active")
        try:
            if state.activation != Activation.ACTIVATING:
                await link.activate(False)
                await link.activate(True)
        except NoAnswer as exc:
            raise error("CALL_TIMEOUT", f"{self.name} was told to activate, and there was {exc}") from exc

        def settled(state: RobotiqState) -> bool:
            return state.activation == Activation.ACTIVE or state.fault not in {0, *MINOR_FAULTS}

        if not await self._becomes(settled, ACTIVATION_S):
            raise error("GRIPPER_NOT_ACTIVE", f"{self.name}: it was not active after {ACTIVATION_S:g} s")
        self._refuse_fault(self.states.latest(ACTIVATION_S).value)

    def _refuse_fault(self, state: RobotiqState) -> None:
        if state.fault and state.fault not in MINOR_FAULTS:
            words = FAULTS.get(state.fault, "its manual has it under gFLT")
            raise error("GRIPPER_FAULT", f"{self.name}: fault {state.fault:02X}h, {words}")

    async def _connect(self) -> Identity:
        config = self._config
        if config.is_urcap:
            self._link = UrcapRobotiq(self.name, config.url, config.timeout_s, config.connect_timeout_s)
        else:
            settings = LinkSettings(
                url=config.url,
                address=parse_url(config.url),
                unit=config.unit,
                timeout_s=config.timeout_s,
                connect_timeout_s=config.connect_timeout_s,
                keys="url and unit",
            )
            self._link = ModbusRobotiq(ModbusLink(self.name, settings, self._clock, self._disconnected))
        await self._link.connect()
        return Identity("Robotiq", config.serial, "", {"told": False})

    async def _disconnect(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            await link.close()

    async def _ask(self) -> RobotiqState:
        return await self._opened(self._link).state()

    def _holds(self, state: RobotiqState) -> bool:
        return state.fingers is self._stopped and state.requested == self._config.closed

    def _shown(self, state: RobotiqState | None) -> dict[str, Any]:
        return {
            "closed": None if state is None else state.requested == self._config.closed,
            "holding": None if state is None else self._holds(state),
            "active": None if state is None else state.activation == Activation.ACTIVE,
            "position": None if state is None else state.position,
            "fault": None if state is None else FAULTS.get(state.fault, str(state.fault or "")),
        }

    def _disconnected(self) -> None:
        if self._life.lose(error("DEVICE_LOST", f"{self.name}: the other end closed the connection")):
            self._life.stop_work()
