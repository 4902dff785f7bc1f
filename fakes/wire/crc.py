"""The CRC-16 of Modbus and GeoCOM: reflected polynomial 0xA001; they differ in what they start from."""


def crc16(data: bytes, start: int) -> int:
    """The check sum of ``data``."""
    crc = start
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc
