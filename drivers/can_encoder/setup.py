"""Bringing a CiA 406 node from whatever state to sending its position: check, map, time, range, heartbeat."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import CellError, error
from drivers.can_encoder.config import CanopenEncoderConfig
from drivers.can_encoder.sdo import SdoAbort, SdoClient
from drivers.can_encoder.words import NOT_THERE, READ_ONLY

START, PRE_OPERATIONAL = 0x01, 0x80  # NMT commands
_NMT_ID = 0x000
_ENCODER_PROFILE = 406
_KINDS = {1: "single-turn encoder", 2: "multi-turn encoder"}
_POSITION, _SPEED = 0x6004_00_20, 0x6030_01_10  # mapping entries: index, sub-index, bits
_SCALING = 0x04  # bit of 6000h
_EVENT_TYPES = (0xFE, 0xFF)  # by the timer; devices take one of the two, or both
_CYCLIC_TYPE = 1  # with every SYNC, for a device that takes neither
_FULL_RANGE = 1 << 32  # 6002h has 32 bits, and makers write this as 0
_COB_OFF, _COB_FLAGS = 1 << 31, 0xC000_0000
_ASK_AGAIN_S = 0.1

Send = Callable[[int, bytes], Awaitable[None]]


@dataclass(frozen=True)
class NodeSetup:
    """What the node has been brought to."""

    identity: Identity
    modulus: int
    position: slice  # of the frame's data
    speed: slice | None
    heartbeat: bool
    by_sync: bool  # its frames come with SYNC, which somebody has to send


async def set_up(
    name: str, config: CanopenEncoderConfig, sdo: SdoClient, send: Send, clock: Clock
) -> NodeSetup:
    """Configure node ``config.node`` and start it.

    ``DEVICE_UNREACHABLE`` when it does not answer in time, ``ENCODER_OTHER_DEVICE`` when it is no encoder,
    ``ENCODER_REFUSED`` when it does not take a setting, ``ENCODER_RANGE`` when its range is of no use.
    """
    kind = await _wait_for_node(name, config, sdo, send, clock)
    if kind & 0xFFFF != _ENCODER_PROFILE:
        raise error(
            "ENCODER_OTHER_DEVICE",
            f"{name}: node {config.node} has device profile {kind & 0xFFFF},"
            f" an encoder has {_ENCODER_PROFILE}",
        )
    try:
        await send(_NMT_ID, bytes([PRE_OPERATIONAL, config.node]))
        identity = await _identity(kind, sdo)
        modulus = await _range(name, config, sdo)
        heartbeat = await _heartbeat(config, sdo)
        position, speed, by_sync = await _map(name, config, sdo)
        await send(_NMT_ID, bytes([START, config.node]))
    except SdoAbort as exc:
        raise error("ENCODER_REFUSED", f"{name}: node {config.node}, {exc}") from exc
    return NodeSetup(identity, modulus, position, speed, heartbeat, by_sync)


async def _wait_for_node(
    name: str, config: CanopenEncoderConfig, sdo: SdoClient, send: Send, clock: Clock
) -> int:
    """The device type 1000h, asked for until the time is over: a node may still be starting.

    One that was stopped answers no SDO, so it is sent back to where it does.
    """
    begun = clock.now()
    while True:
        try:
            return await sdo.read(0x1000)
        except SdoAbort as exc:
            raise error("ENCODER_REFUSED", f"{name}: node {config.node}, {exc}") from exc
        except CellError as exc:
            if clock.now() - begun > config.connect_timeout_s:
                raise error(
                    "DEVICE_UNREACHABLE",
                    f"{name}: no node {config.node} answers on {config.bus}"
                    " (power, wiring, bit rate, node number?)",
                ) from exc
        await send(_NMT_ID, bytes([PRE_OPERATIONAL, config.node]))
        await clock.sleep(_ASK_AGAIN_S)


async def _identity(kind: int, sdo: SdoClient) -> Identity:
    vendor, product, revision, serial = [await _optional(sdo, 0x1018, sub) for sub in (1, 2, 3, 4)]
    model = f"CiA 406 {_KINDS.get(kind >> 16, 'encoder')}"
    version = "" if revision is None else f"{revision >> 16}.{revision & 0xFFFF}"
    extra = {"vendor": vendor, "product": product}
    return Identity(
        model,
        "" if serial is None else str(serial),
        version,
        {key: value for key, value in extra.items() if value is not None},
    )


async def _range(name: str, config: CanopenEncoderConfig, sdo: SdoClient) -> int:
    """Write the scaling that is wished for; the range that counts is what the encoder then has.

    An encoder without object 6002h has the range that its manual says, so it has to be configured.
    """
    has_range = await _optional(sdo, 0x6002, 0) is not None
    wished = {0x6001: config.units_per_revolution, 0x6002: config.range_counts if has_range else None}
    if any(value is not None for value in wished.values()):
        operating = await sdo.read(0x6000)
        for index, value in wished.items():
            if value is not None:
                await sdo.write_sized(index, 0, value % _FULL_RANGE, 4)
        await sdo.write_sized(0x6000, 0, operating | _SCALING, 2)
    if not has_range and config.range_counts is None:
        raise error(
            "ENCODER_RANGE",
            f"{name}: node {config.node} does not tell its range (no object 6002h); set range_counts to the "
            "one in its manual",
        )
    found = (await sdo.read(0x6002) or _FULL_RANGE) if has_range else config.range_counts or _FULL_RANGE
    if found < 2 or config.range_counts not in (None, found):
        wanted = "" if config.range_counts is None else f", wanted are {config.range_counts}"
        raise error("ENCODER_RANGE", f"{name}: node {config.node} has a range of {found} counts{wanted}")
    return found


async def _heartbeat(config: CanopenEncoderConfig, sdo: SdoClient) -> bool:
    """Whether the node now sends heartbeats; a simple one may have none to send."""
    try:
        await sdo.write_sized(0x1017, 0, round(1000.0 * config.heartbeat_s), 2)
    except SdoAbort as exc:
        if exc.code not in NOT_THERE:
            raise
        return False
    return config.heartbeat_s > 0.0


async def _map(name: str, config: CanopenEncoderConfig, sdo: SdoClient) -> tuple[slice, slice | None, bool]:
    """Off, map, time, on, as CiA 301 wants it; where position and speed lie in the frame, and whether it
    comes with SYNC.

    A device with a fixed mapping is taken as it is when the position is in it.
    """
    settings, mapping = 0x1800 + config.tpdo - 1, 0x1A00 + config.tpdo - 1
    old = await sdo.read(settings, 1)
    await sdo.write(settings, 1, old | _COB_OFF, 4)
    wished = [_POSITION, _SPEED] if config.speed else [_POSITION]
    refusal = ""
    if await _entries(sdo, mapping) != wished:
        try:
            await sdo.write(mapping, 0, 0, 1)
            for k, entry in enumerate(wished, 1):
                await sdo.write(mapping, k, entry, 4)
            await sdo.write(mapping, 0, len(wished), 1)
        except SdoAbort as exc:
            refusal = str(exc)
    places = _places(await _entries(sdo, mapping))
    if _POSITION not in places:
        raise error(
            "ENCODER_REFUSED", f"{name}: TPDO {config.tpdo} does not carry the position 6004h; {refusal}"
        )
    by_sync = await _time(name, config, sdo, settings)
    on = (old & _COB_FLAGS & ~_COB_OFF) | config.position_id
    await sdo.write(settings, 1, on, 4)
    if await sdo.read(settings, 1) & ~_COB_FLAGS != config.position_id:
        raise error(
            "ENCODER_REFUSED", f"{name}: TPDO {config.tpdo} does not take identifier {config.position_id:#x}"
        )
    return places[_POSITION], places.get(_SPEED), by_sync


async def _time(name: str, config: CanopenEncoderConfig, sdo: SdoClient, settings: int) -> bool:
    """Send by the timer; whether it has to be by SYNC instead."""
    for kind in (*_EVENT_TYPES, _CYCLIC_TYPE):
        try:
            await sdo.write(settings, 2, kind, 1)
            break
        except SdoAbort as exc:
            refusal = exc
    else:
        raise refusal
    await _inhibit(config, sdo, settings)
    if kind == _CYCLIC_TYPE:
        return True
    milliseconds = round(1000.0 * config.period_s)
    index, sub = settings, 5  # which older encoders have as 6200h
    try:
        await sdo.write_sized(index, sub, milliseconds, 2)
    except SdoAbort as exc:
        if exc.code not in NOT_THERE:
            raise
        index, sub = 0x6200, 0
        await sdo.write_sized(index, sub, milliseconds, 2)
    if (found := await sdo.read(index, sub)) != milliseconds:
        raise error("ENCODER_REFUSED", f"{name}: the timer is {found} ms instead of {milliseconds} ms")
    return False


async def _inhibit(config: CanopenEncoderConfig, sdo: SdoClient, settings: int) -> None:
    """No frames between those of the timer: many encoders send one with every count that changes.

    The inhibit time counts in tenths of a millisecond; one less than the period leaves the timer its turn. A
    device without it is taken as it is.
    """
    try:
        await sdo.write_sized(settings, 3, round(10_000.0 * config.period_s) - 1, 2)
    except SdoAbort as exc:
        if exc.code not in (*NOT_THERE, READ_ONLY):
            raise


async def _entries(sdo: SdoClient, mapping: int) -> list[int]:
    return [await sdo.read(mapping, k) for k in range(1, await sdo.read(mapping, 0) + 1)]


def _places(entries: list[int]) -> dict[int, slice]:
    """The bytes of each mapped object; those that do not begin at a byte are of no use to us."""
    found, bit = {}, 0
    for entry in entries:
        bits = entry & 0xFF
        if bit % 8 == 0 and bits % 8 == 0:
            found[entry] = slice(bit // 8, (bit + bits) // 8)
        bit += bits
    return found


async def _optional(sdo: SdoClient, index: int, sub: int) -> int | None:
    try:
        return await sdo.read(index, sub)
    except SdoAbort:
        return None
