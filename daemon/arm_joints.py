"""Where the arm stands, for somebody who gives a pose a name."""

from typing import Any

from cell.devices import Arm
from cell.errors import error
from cell.kinds import as_kind
from daemon.cell_context import CellContext

STATE_AGE_S = 0.5
MOVING_RAD_S = 1e-3


def arm_joints(context: CellContext) -> dict[str, Any]:
    """``q`` (rad, as the controller counts them) and whether the arm is ``moving``.

    ``DEVICE_NOT_READY`` when [robot] names no arm, ``STALE_DATA`` when it told nothing lately.
    """
    name = context.config.robot.roles().get("arm")
    if name is None:
        raise error("DEVICE_NOT_READY", "[robot] names no arm")
    state = as_kind(context.supervisor.devices[name].device, Arm).state.latest(STATE_AGE_S).value
    return {"q": state.q.tolist(), "moving": bool(abs(state.qd).max() > MOVING_RAD_S)}
