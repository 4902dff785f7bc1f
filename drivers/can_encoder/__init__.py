"""Belt encoders on CAN: CiA 406 and raw frames, through socketcan, serial adapters and socketcand."""

from drivers.can_encoder.canopen import CanopenEncoder
from drivers.can_encoder.config import CanopenEncoderConfig, RawCanEncoderConfig
from drivers.can_encoder.raw import RawCanEncoder

__all__ = ["CanopenEncoder", "CanopenEncoderConfig", "RawCanEncoder", "RawCanEncoderConfig"]
