"""An encoder that sends its position by itself, in frames of any form."""

import can

from cell.clock import Clock
from cell.devices import Encoder, Identity
from drivers.can_encoder.base import CanEncoder
from drivers.can_encoder.config import RawCanEncoderConfig


class RawCanEncoder(CanEncoder):
    """Listens; nothing is sent, and nothing says which device it is."""

    Config = RawCanEncoderConfig
    PLAYS = (Encoder,)

    def __init__(self, name: str, config: RawCanEncoderConfig, clock: Clock) -> None:
        super().__init__(name, config, clock, config.modulus)
        self._config = config
        self._bytes = slice(config.offset_bytes, config.offset_bytes + config.width_bits // 8)

    def _ids(self) -> list[tuple[int, bool]]:
        return [(self._config.id, self._config.extended)]

    async def _begin(self) -> Identity:
        return Identity("encoder with raw CAN frames", "")

    def _position(self, message: can.Message) -> int | None:
        config = self._config
        if message.arbitration_id != config.id or message.is_extended_id != config.extended:
            return None
        if len(message.data) < self._bytes.stop:
            self._short += 1
            return None
        value = int.from_bytes(message.data[self._bytes], config.byte_order, signed=config.signed)
        # A signed position is the same one modulo its width.
        return value % config.modulus if config.signed else value
