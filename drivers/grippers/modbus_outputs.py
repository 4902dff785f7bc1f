"""A gripper whose valve hangs on one or two outputs of a Modbus module."""

from dataclasses import dataclass
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from cell.clock import Clock
from cell.devices import Gripper, Identity
from cell.errors import error
from drivers.grippers.polled import PolledConfig, PolledGripper
from drivers.modbus.address import parse_url
from drivers.modbus.link import LinkSettings, ModbusLink, NoAnswer, TlsFiles
from drivers.modbus.registers import Span, Table
from drivers.valve import check_valve

_READ_BACK_S = 0.5


class ModbusGripperConfig(PolledConfig):
    """Keys of a device with ``driver = "modbus-gripper"``.

    What its outputs do when the connection is lost is set in the module itself: let them stay as they are.
    """

    url: str = Field(
        description="tcp://host:port, tls://host:port, or"
        " rtu:///dev/ttyUSB0?baudrate=115200&parity=N&stopbits=1"
    )
    unit: int = Field(default=1, ge=0, le=255, description="Unit identifier; 1 to 247 on a serial line")
    output: int = Field(ge=0, le=65535, description="Coil that is on when closed")
    invert_output: bool = Field(default=False, description="Off closes")
    open_output: int | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="Another coil, on opens: of a valve with two coils, or the one that blows off a vacuum",
    )
    read_back: int | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="Coil where the state of output is read; absent: where it is written",
    )
    blow_off_s: float | None = Field(
        default=None, gt=0, le=5, description="open_output is on for so long; absent: until it closes again"
    )
    confirm: int | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="Input of the module that is on while something is held; absent: unknown",
    )
    confirm_table: Literal["discrete", "coils"] = Field(
        default="discrete", description="Modbus table of that input"
    )
    invert_confirm: bool = Field(default=False, description="true: the input is off while something is held")
    moves_s: float | None = Field(
        default=None,
        gt=0,
        le=5,
        description="Without confirm: it counts as closed, or open, after so long, whether it holds or not",
    )
    tls_ca: str | None = Field(default=None, description="PEM file that its certificate is checked with")

    @model_validator(mode="after")
    def _checked(self) -> Self:
        parse_url(self.url)
        check_valve(self)
        return self


@dataclass(frozen=True)
class ModbusGripperState:
    """``output`` is the level of the coil that closes; ``confirm`` that of the input, None without one."""

    output: bool
    confirm: bool | None


class ModbusGripper(PolledGripper[ModbusGripperState]):
    """``cell.devices.Gripper``. It writes in :meth:`grip` and :meth:`release` only, one coil at a time: the
    one that goes off first, so that a valve never has both."""

    Config = ModbusGripperConfig
    PLAYS = (Gripper,)

    def __init__(self, name: str, config: ModbusGripperConfig, clock: Clock) -> None:
        super().__init__(name, config, clock)
        self._config = config
        self._link: ModbusLink | None = None
        back = config.output if config.read_back is None else config.read_back
        self._output = Span(Table.COILS, back, 1)
        self._confirm = (
            None if config.confirm is None else Span(Table(config.confirm_table), config.confirm, 1)
        )

    @property
    def confirms(self) -> bool:
        """Whether an input tells that something is held."""
        return self._config.confirm is not None

    async def grip(self, timeout: float) -> bool:
        """Close; True when the confirm input came within ``timeout`` s, or after ``moves_s`` without one."""
        await self._write(close=True, opening=False)
        return await self._answers(True, timeout)

    async def release(self, timeout: float) -> bool:
        """Open; True when the confirm input went within ``timeout`` s, or after ``moves_s`` without one."""
        begun = self._clock.now()
        await self._write(close=False, opening=True)
        opened = await self._answers(False, timeout)
        if self._config.blow_off_s is not None:
            await self._clock.sleep(max(begun + self._config.blow_off_s - self._clock.now(), 0.0))
            await self._write(close=False, opening=False)
        return opened

    # -- inside

    async def _connect(self) -> Identity:
        config = self._config
        settings = LinkSettings(
            url=config.url,
            address=parse_url(config.url),
            unit=config.unit,
            timeout_s=config.timeout_s,
            connect_timeout_s=config.connect_timeout_s,
            keys="output, open_output, read_back and confirm",
            tls=TlsFiles(config.tls_ca),
        )
        self._link = ModbusLink(self.name, settings, self._clock, self._disconnected)
        await self._link.connect()
        return Identity("Modbus outputs", config.serial, "", {"told": False})

    async def _disconnect(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            await link.close()

    async def _ask(self) -> ModbusGripperState:
        link = self._opened(self._link)
        (output,) = await link.read(self._output)
        confirm = None if self._confirm is None else bool((await link.read(self._confirm))[0])
        return ModbusGripperState(bool(output), confirm)

    async def _write(self, close: bool, opening: bool) -> None:
        """Set the coils and read the closing one back; ``CALL_TIMEOUT`` when it does not follow."""
        link = self._opened(self._link)
        level = close is not self._config.invert_output
        levels = [(self._config.output, level)]
        if self._config.open_output is not None:
            levels.append((self._config.open_output, opening))
        for coil, on in sorted(levels, key=lambda one: one[1]):
            try:
                await link.write_coil(coil, on)
            except NoAnswer as exc:
                raise error(
                    "CALL_TIMEOUT", f"{self.name}: coil {coil} was written, and there was {exc}"
                ) from exc
        if not await self._becomes(lambda state: state.output is level, _READ_BACK_S):
            raise error(
                "CALL_TIMEOUT", f"{self.name}: coil {self._output.start} did not follow in {_READ_BACK_S:g} s"
            )

    async def _answers(self, held: bool, timeout: float) -> bool:
        config = self._config
        if config.confirm is not None or config.moves_s is None:
            return await self._becomes(lambda state: self._holds(state) is held, timeout)
        if config.moves_s > timeout:
            raise error(
                "ARGUMENT_INVALID",
                f"{self.name}: moves_s is {config.moves_s:g} s, and the timeout is {timeout:g} s",
            )
        await self._clock.sleep(config.moves_s)
        self._life.require()
        return True

    def _holds(self, state: ModbusGripperState) -> bool:
        if state.confirm is None:
            return self._is_closed(state)
        return state.confirm is not self._config.invert_confirm

    def _is_closed(self, state: ModbusGripperState) -> bool:
        return state.output is not self._config.invert_output

    def _shown(self, state: ModbusGripperState | None) -> dict[str, Any]:
        return {
            "closed": None if state is None else self._is_closed(state),
            "holding": None if state is None else self._holds(state),
        }

    def _disconnected(self) -> None:
        if self._life.lose(error("DEVICE_LOST", f"{self.name}: the other end closed the connection")):
            self._life.stop_work()
