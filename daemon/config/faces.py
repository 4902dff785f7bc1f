"""How others reach the daemon: the sections of its Modbus, CAN and web servers."""

import ipaddress
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from daemon.config.section import GrownSection, Section, absolute
from drivers.can_bus.address import parse_bus


def split_bind(bind: str) -> tuple[str, int]:
    """``host:port`` or ``[v6]:port`` as host and port; ``ValueError`` says what is wrong."""
    host, colon, port = bind.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not colon or not port.isdecimal() or int(port) > 65535:
        raise ValueError("an address and a port as in '127.0.0.1:5020' were expected")
    if host != "localhost":
        ipaddress.ip_address(host)
    return host, int(port)


def _bind(value: str) -> str:
    split_bind(value)
    return value


def _network(value: str) -> str:
    ipaddress.ip_network(value)
    return value


def _bus(value: str) -> str:
    parse_bus(value)
    return value


CanId = Annotated[int, Field(ge=0x001, le=0x7FF)]
Bind = Annotated[str, AfterValidator(_bind)]


class ModbusSection(GrownSection):
    """The Modbus server for a PLC or a panel. Reading is open to whoever reaches the address."""

    LATER = frozenset({"tls_cert", "tls_key", "tls_clients_ca"})

    enabled: bool = Field(default=True, description="false: no Modbus server")
    bind: Bind = Field(default="127.0.0.1:5020", description="address and port to listen on")
    allow_write: bool = Field(
        default=False, description="true: clients in allow_clients may write the command registers"
    )
    allow_clients: list[Annotated[str, AfterValidator(_network)]] = Field(
        default_factory=list, description="addresses or networks that may write; empty: none"
    )
    allow_accept: bool = Field(default=False, description="command 8 may accept results")
    word_order: Literal["high-first", "low-first"] = Field(
        default="high-first", description="order of the two registers of a 32-bit value"
    )
    heartbeat_timeout_s: float = Field(
        default=1.0,
        ge=0.2,
        le=60.0,
        description="silence of the PLC's heartbeat, once seen, that holds the job",
    )
    require_enable: bool = Field(default=False, description="start only while control bit 0 (enable) is set")
    max_connections: int = Field(
        default=16, ge=1, le=256, description="most clients that are connected at the same time"
    )
    idle_timeout_s: float = Field(
        default=60.0, ge=1.0, le=3600.0, description="a connection without a request for so long is closed"
    )
    tls_cert: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None,
        description="our certificate (PEM); with it every connection is TLS, usually on port 802",
    )
    tls_key: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None, description="its key (PEM), readable by the daemon alone"
    )
    tls_clients_ca: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None,
        description="certificates (PEM) that sign those of the clients; a client without one is refused",
    )

    @model_validator(mode="after")
    def _tls_is_mutual(self) -> Self:
        given = (self.tls_cert, self.tls_key, self.tls_clients_ca)
        if None in given and any(given):
            raise ValueError("tls_cert, tls_key and tls_clients_ca belong together: give all or none")
        return self


Role = Literal["viewer", "operator", "integrator"]


class UserSection(Section):
    """One person, or one panel, that may log in to the page."""

    role: Role = Field(
        default="viewer",
        description="viewer: looks, and may stop a run; operator: also starts jobs, confirms, and accepts "
        "what passed; integrator: also accepts with warnings, rolls back and resets",
    )
    token_sha256: str = Field(
        pattern=r"^[0-9a-f]{64}$",
        description="digest of the token that 'cellward token NAME' makes; the token itself is kept nowhere",
    )


class CanSection(Section):
    """The CAN trigger: the commands of the Modbus server on a bus, which an encoder may share.

    A bus has no sender identity, so whoever is on it may command.
    """

    enabled: bool = Field(default=False, description="true: commands are taken from the bus")
    bus: Annotated[str, AfterValidator(_bus)] = Field(
        default="socketcan:can0", description="as the key bus of an encoder; the same text is the same bus"
    )
    command_id: CanId = Field(default=0x300, description="identifier of the PLC's command frames, 11 bits")
    acknowledge_id: CanId = Field(default=0x301, description="identifier of our acknowledge frames")
    status_id: CanId = Field(default=0x302, description="identifier of our status frames")
    node: int = Field(default=126, ge=1, le=127, description="our heartbeat has the identifier 0x700 + node")
    heartbeat_s: float = Field(
        default=0.1, ge=0.02, le=10.0, description="period of heartbeat and status frames"
    )
    plc_node: int | None = Field(
        default=None, ge=1, le=127, description="the PLC's heartbeat is 0x700 + plc_node; none: not watched"
    )
    heartbeat_timeout_s: float = Field(
        default=1.0,
        ge=0.2,
        le=60.0,
        description="silence of the PLC's heartbeat, once seen, that holds the job",
    )
    allow_accept: bool = Field(default=False, description="command 8 may accept results")

    @model_validator(mode="after")
    def _identifiers_differ(self) -> Self:
        nodes = [0x700 + node for node in (self.node, self.plc_node) if node is not None]
        numbers = [self.command_id, self.acknowledge_id, self.status_id, *nodes]
        if len(set(numbers)) < len(numbers):
            raise ValueError("command_id, acknowledge_id, status_id and the heartbeats must all differ")
        return self


class HttpSection(Section):
    """The operator's page. Nothing can be done on it without a token; without this section there is none."""

    enabled: bool = Field(default=True, description="false: no page")
    bind: Bind = Field(
        default="127.0.0.1:8420",
        description="address and port to listen on; beyond this computer only with tls_cert and tls_key",
    )
    names: list[Annotated[str, Field(pattern=r"^[A-Za-z0-9.-]{1,253}$")]] = Field(
        default_factory=list,
        description="further host names by which browsers may ask for the page; others are refused",
    )
    tls_cert: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None, description="certificate of the page (PEM)"
    )
    tls_key: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None, description="its key (PEM), readable by the daemon alone"
    )
    look_without_login: bool = Field(
        default=False,
        description="true: whoever reaches the address may look; to do anything takes a token all the same",
    )
    session_s: float = Field(
        default=43200.0, ge=60.0, le=2.6e6, description="a login ends after so long without doing anything"
    )
    user: dict[Annotated[str, Field(pattern=r"^[\w.-]{1,32}$")], UserSection] = Field(
        default_factory=dict, description="one table a user, [http.user.NAME]"
    )

    @model_validator(mode="after")
    def _no_plain_text_on_the_network(self) -> Self:
        host = split_bind(self.bind)[0]
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("tls_cert and tls_key belong together: give both or neither")
        if self.tls_cert is None and not is_loopback(host):
            raise ValueError(
                f'bind = "{self.bind}" is reached from other computers: give tls_cert and tls_key, or bind '
                "to 127.0.0.1"
            )
        if host != "localhost" and ipaddress.ip_address(host).is_unspecified and not self.names:
            raise ValueError("with every address in bind, 'names' lists the names that browsers use")
        return self


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches ``host``."""
    return host == "localhost" or ipaddress.ip_address(host).is_loopback
