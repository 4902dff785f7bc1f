"""Who uses the registers of a controller that the motion client needs."""

from collections.abc import Sequence

from cell.clock import Clock
from cell.errors import CellError
from drivers.ur.rtde_link import RtdeLink

# What the motion child's client claims when it starts.
MOTION_REGISTERS = (
    *(f"input_int_register_{k}" for k in range(8)),
    *(f"input_double_register_{k}" for k in range(18)),
)


async def registers_in_use(host: str, clock: Clock, timeout: float) -> list[str]:
    """Those registers of the motion client that somebody else holds: a fieldbus, or another RTDE client.

    They are asked for on a connection of its own, are never written, and are free again when it ends.
    """
    link = await RtdeLink.connect(host, clock, _nobody_minds, timeout)
    try:
        recipe = await link.setup_inputs(MOTION_REGISTERS, timeout)
    finally:
        link.close()
    return [name for name, kind in zip(recipe.names, recipe.types, strict=True) if kind == "IN_USE"]


def registers_warning(arm: str, names: Sequence[str]) -> str:
    """What cannot be had together, and the ways out."""
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return (
        f"{arm}: {shown} are in use by a fieldbus of the controller or by another RTDE client, and jobs that"
        " move the arm need input_int_register_0 to 7 and input_double_register_0 to 17: both cannot be had"
        " together. Disable PROFINET or EtherNet/IP in the installation and let the PLC use the Modbus server"
        " of this program, or end the other client; while a job of this program moves the arm, it is that"
    )


def _nobody_minds(failure: CellError) -> None:
    """The request that waits for the link gets the failure."""
