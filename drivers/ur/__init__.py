"""Universal Robots arms: state by our own RTDE subscriber, motion by a supervised child process.

The motion child imports this package too and has to start fast, so the arm is imported on first use.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.ur.arm import UrArm
    from drivers.ur.config import UrConfig

__all__ = ["UrArm", "UrConfig"]


def __getattr__(name: str) -> Any:
    if name == "UrArm":
        from drivers.ur.arm import UrArm

        return UrArm
    if name == "UrConfig":
        from drivers.ur.config import UrConfig

        return UrConfig
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
