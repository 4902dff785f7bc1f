"""The warning bits of a register by their names."""

from daemon.warning_bits import WARNING_BITS


def warnings_shown(value: int) -> list[str]:
    """The names of the bits that are set in ``value``."""
    return [bit.name for number, bit in enumerate(WARNING_BITS) if value >> number & 1]
