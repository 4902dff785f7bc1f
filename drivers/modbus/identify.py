"""Who a module is: function 43/14 where it answers that, else registers, else what the config calls it."""

from cell.devices import Identity
from cell.errors import CellError
from drivers.modbus.link import ModbusLink, NoAnswer
from drivers.modbus.registers import NumberConfig, SerialConfig, words_to_int

VENDOR, PRODUCT, REVISION, SERIAL = 0x00, 0x01, 0x02, 0x80
_BASIC, _SINGLE = 1, 4
_MOST_PARTS = 8


async def identify(link: ModbusLink, called: str, place: SerialConfig | None) -> Identity:
    """Ask the device, which the config calls ``called`` and whose serial may be in registers at ``place``.

    Many do not know function 43, and some do not even refuse it.
    """
    told = await _basic(link)
    serial = await _single(link, SERIAL) if told else ""
    if not serial and place is not None:
        serial = await _registers(link, place)
    model = told.get(PRODUCT) or called
    extra = {"vendor": told[VENDOR]} if told.get(VENDOR) else {}
    return Identity(model, serial, told.get(REVISION, ""), extra)


async def read_number(link: ModbusLink, place: NumberConfig) -> int:
    """The number in registers of the module."""
    return words_to_int(await link.read(place.span), place.word_order == "low-first")


async def _registers(link: ModbusLink, place: SerialConfig) -> str:
    if place.kind == "number":
        return str(await read_number(link, place))
    words = await link.read(place.span)
    if place.word_order == "low-first":
        words = words[::-1]
    return _text(b"".join(word.to_bytes(2, "big") for word in words))


async def _basic(link: ModbusLink) -> dict[int, str]:
    """Vendor, product and revision, in as many parts as the module sends them in."""
    found: dict[int, str] = {}
    following = 0
    for _ in range(_MOST_PARTS):
        try:
            objects, following = await link.identification(_BASIC, following)
        except (CellError, NoAnswer):
            break
        found |= {number: _text(value) for number, value in objects.items()}
        if not following:
            break
    return found


async def _single(link: ModbusLink, number: int) -> str:
    try:
        objects, _ = await link.identification(_SINGLE, number)
    except (CellError, NoAnswer):
        return ""
    return _text(objects.get(number, b""))


def _text(value: bytes) -> str:
    return value.split(b"\0")[0].decode("ascii", "replace").strip()
