"""What ``[device.beams]`` in cell.toml may say."""

from dataclasses import replace
from typing import Literal, Self

from pydantic import Field, model_validator

from cell.formats.reading import Strict
from drivers.digital import InputConfig
from drivers.life import TIME_OFFSET
from drivers.modbus.address import ModbusAddress, parse_url
from drivers.modbus.link import LinkSettings, TlsFiles
from drivers.modbus.registers import NumberConfig, RegisterTable, SerialConfig, Table, WordOrder
from drivers.modbus_inputs.models import GENERIC, MODELS, CounterPlace, LevelPlace, ModuleModel
from drivers.modbus_inputs.plan import ReadPlan

_BITS_PER_BYTE = 11.0

TableName = Literal["coils", "discrete", "holding", "input"]


class LevelsConfig(Strict):
    """Where a generic module keeps its levels: bits, or registers of 16 of them, lowest bit first."""

    table: TableName = Field(default="discrete", description="Modbus table of the levels")
    address: int = Field(default=0, ge=0, le=65535, description="Bit or register that holds input 0")


class CountersConfig(Strict):
    """Where a generic module keeps its counters of rising edges, one for each input in a row."""

    table: RegisterTable = Field(default="input", description="Modbus table of the counters")
    address: int = Field(ge=0, le=65535, description="First register of the counter of input 0")
    width: Literal[16, 32] = Field(default=32, description="bits of a counter")
    word_order: WordOrder = Field(default="high-first", description="of counters with 32 bits")


class InputsConfig(Strict):
    """Keys of a device with ``driver = "modbus-inputs"``."""

    url: str = Field(
        description="tcp://host:port, tls://host:port, or"
        " rtu:///dev/ttyUSB0?baudrate=115200&parity=N&stopbits=1"
    )
    module: Literal["generic", "ioLogik-E1210", "ADAM-6050", "WAGO-750"] = Field(
        default="generic",
        description="model whose register map is used; generic: levels and counters say where they are",
    )
    unit: int = Field(default=1, ge=0, le=255, description="Unit identifier; 1 to 247 on a serial line")
    inputs: dict[str, InputConfig] = Field(
        min_length=1,
        description="By name, as in { xs = { address = 0, invert = false, stuck_on_s = 60.0 } }",
    )
    expect_serial: str | None = Field(default=None, description="Serial number that the module must have")
    poll_period_s: float = Field(
        default=0.005, ge=0.001, le=1.0, description="time between two polls of the inputs"
    )
    time_offset_s: float = Field(
        default=0.0,
        ge=-0.1,
        le=0.1,
        description=TIME_OFFSET,
    )
    filter_s: float | None = Field(
        default=None,
        ge=0.0,
        le=1.0,
        description="The filter that is set in the module for these inputs, which it does not tell: a level"
        " counts once it has lasted so long",
    )
    timeout_s: float = Field(default=0.2, ge=0.005, le=2.0, description="Longest wait for one reply")
    connect_timeout_s: float = Field(
        default=3.0, gt=0.0, le=15.0, description="longest wait for a connection, s"
    )
    lost_after_failures: int = Field(
        default=3, ge=1, le=20, description="Polls in a row without an answer that end the link"
    )
    use_counters: bool = Field(
        default=True, description="false: the module's counters are not enabled, levels alone are read"
    )
    levels: LevelsConfig | None = Field(default=None, description="generic module only")
    counters: CountersConfig | None = Field(default=None, description="generic module only")
    serial: SerialConfig | None = Field(
        default=None, description="Where the serial number is, if function 43 does not tell it"
    )
    uptime: NumberConfig | None = Field(
        default=None,
        description="A number that grows from the module's start on, at least once a second. It is looked at "
        "once a second: one that falls is a restart, one that stands still a module that repeats old values",
    )
    tls_ca: str | None = Field(
        default=None, description="PEM file that the module's certificate is checked with"
    )
    tls_certificate: str | None = Field(default=None, description="PEM file of our own certificate")
    tls_key: str | None = Field(default=None, description="PEM file of our own key")
    tls_server_name: str | None = Field(default=None, description="Name in the certificate; absent: the host")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        address = parse_url(self.url)
        self._check_tls(address)
        if self.module != "generic" and (self.levels or self.counters):
            raise ValueError(f"levels and counters are for module = 'generic'; {self.module} has its own")
        self._check_channels()
        self._check_line(address)
        return self

    @property
    def link(self) -> LinkSettings:
        """How to connect."""
        return LinkSettings(
            url=self.url,
            address=parse_url(self.url),
            unit=self.unit,
            timeout_s=self.timeout_s,
            connect_timeout_s=self.connect_timeout_s,
            keys="module and the addresses of the inputs",
            tls=TlsFiles(self.tls_ca, self.tls_certificate, self.tls_key, self.tls_server_name),
        )

    @property
    def model(self) -> ModuleModel:
        """The module's description, with what the config says about it."""
        model = MODELS[self.module]
        if self.levels is not None:
            model = replace(model, levels=LevelPlace(Table(self.levels.table), self.levels.address))
        if (c := self.counters) is not None:
            low_first = c.word_order == "low-first"
            model = replace(model, counters=CounterPlace(Table(c.table), c.address, c.width, low_first))
        return model if self.use_counters else replace(model, counters=None)

    @property
    def plan(self) -> ReadPlan:
        """What a poll reads; ``ValueError`` when no request can."""
        return ReadPlan(self.model, [c.address for c in self.inputs.values()])

    def _check_tls(self, address: ModbusAddress) -> None:
        if address.scheme != "tls":
            for key in ("tls_ca", "tls_certificate", "tls_key", "tls_server_name"):
                if getattr(self, key) is not None:
                    raise ValueError(f"{key} is for a tls:// url, not for {self.url}")
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key are needed together")

    def _check_channels(self) -> None:
        names: dict[int, str] = {}
        for name, config in self.inputs.items():
            if (other := names.setdefault(config.address, name)) != name:
                raise ValueError(f"inputs {other} and {name} have the same address {config.address}")
            channels = MODELS[self.module].channels
            if channels < GENERIC.channels and config.address >= channels:
                raise ValueError(
                    f"input {name} has address {config.address},"
                    f" but {self.module} has inputs 0 to {channels - 1}"
                )
        self.plan  # noqa: B018 -- its sentence says which span is too wide

    def _check_line(self, address: ModbusAddress) -> None:
        if address.scheme != "rtu":
            return
        if not 1 <= self.unit <= 247:
            raise ValueError(f"unit {self.unit} is not possible on a serial line; it has 1 to 247")
        needed = self.plan.bytes_per_poll * _BITS_PER_BYTE / address.baudrate
        if needed > self.poll_period_s:
            raise ValueError(
                f"poll_period_s = {self.poll_period_s:g} is too short: the bytes of a poll alone take"
                f" {needed:.4f} s at {address.baudrate} baud"
            )
