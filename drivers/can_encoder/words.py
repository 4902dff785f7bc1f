"""What CANopen's numbers mean, in words: abort codes, emergencies, states of a node."""

_ABORTS = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "protocol timed out",
    0x05040001: "unknown command specifier",
    0x06010000: "no access to the object",
    0x06010001: "the object can only be written",
    0x06010002: "the object can only be read",
    0x06020000: "there is no such object",
    0x06040041: "the object cannot be mapped",
    0x06040042: "the mapped objects are longer than a frame",
    0x06040043: "parameters do not fit together",
    0x06060000: "hardware error",
    0x06070010: "wrong length of the value",
    0x06070012: "value too long",
    0x06070013: "value too short",
    0x06090011: "there is no such sub-index",
    0x06090030: "value out of range",
    0x06090031: "value too high",
    0x06090032: "value too low",
    0x08000000: "general error",
    0x08000020: "data cannot be stored",
    0x08000021: "data cannot be stored because of local control",
    0x08000022: "data cannot be stored in the present state of the device",
}
NOT_THERE = (0x06020000, 0x06090011)
WRONG_LENGTH = (0x06070010, 0x06070012, 0x06070013)
READ_ONLY = 0x06010002

# By the longest matching beginning of the four digits (CiA 301, table of emergency codes).
_EMERGENCIES = {
    "0": "no error any more",
    "1": "generic error",
    "2": "current",
    "21": "current on the input side",
    "22": "current inside the device",
    "23": "current on the output side",
    "3": "voltage",
    "31": "supply voltage",
    "32": "voltage inside the device",
    "33": "output voltage",
    "4": "temperature",
    "41": "ambient temperature",
    "42": "temperature of the device",
    "5": "hardware of the device",
    "6": "software of the device",
    "61": "internal software",
    "62": "user software",
    "63": "data set of the device",
    "7": "additional module",
    "8": "monitoring",
    "81": "communication",
    "8110": "CAN overrun, frames were lost",
    "8120": "CAN error passive",
    "8130": "heartbeat or life guard of its master is missing",
    "8140": "recovered from bus off",
    "8150": "two nodes use the same CAN identifier",
    "82": "protocol error",
    "8210": "PDO too short to be used",
    "8220": "PDO too long",
    "9": "external error",
    "F0": "additional function",
    "FF": "device specific",
}
_REGISTER = (
    "generic",
    "current",
    "voltage",
    "temperature",
    "communication",
    "device profile",
    "reserved",
    "manufacturer specific",
)
_STATES = {0: "starting", 4: "stopped", 5: "operational", 127: "pre-operational"}


def abort_words(code: int) -> str:
    """An SDO abort code."""
    return f"{_ABORTS.get(code, 'reason not known')} (abort code {code:08X}h)"


def emergency_words(code: int, register: int) -> str:
    """An emergency code with the bits of the error register 1001h."""
    digits = f"{code:04X}"
    known = (_EMERGENCIES[digits[:n]] for n in (4, 2, 1) if digits[:n] in _EMERGENCIES)
    bits = ", ".join(word for k, word in enumerate(_REGISTER) if register >> k & 1)
    return f"{next(known, 'meaning not known')} ({digits}h{'; ' + bits if bits else ''})"


def state_words(state: int) -> str:
    """The state of a node as its heartbeat tells it."""
    return _STATES.get(state, f"in the unknown state {state}")
