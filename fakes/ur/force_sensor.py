"""The force and moment on the TCP as the controller reports them: zeroed, or written by a client.

The tool of the twin weighs nothing, so payload and gravity change nothing here.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cell.poses import Array

if TYPE_CHECKING:
    from fakes.ur.arm import Arm


ZERO6 = (0.0,) * 6


class ForceSensor:
    """Wrenches (6,) are force (N) and moment (Nm).

    ``written`` holds what clients wrote; its ``external_force_torque`` is in the flange, about its origin.
    """

    def __init__(self, arm: "Arm", written: Mapping[str, tuple[float, ...]]) -> None:
        self._arm, self._written = arm, written
        self._zero: Array | None = None  # in the flange, where the sensor is
        self.use_external = False

    def zero(self, q: Array, contact_force: list[float]) -> None:
        """zero_ftsensor(): subtract the present reading from those to come."""
        self._zero = None
        present = np.array(self.report(q, contact_force)).reshape(2, 3)
        self._zero = (present @ self._turn(q)).ravel()

    def reset(self) -> None:
        """As after power-up."""
        self._zero, self.use_external = None, False

    def report(self, q: Array, contact_force: list[float]) -> list[float]:
        """The wrench on the TCP in the base for joints ``q``; ``contact_force`` is the world's."""
        if self._zero is None and not self.use_external:
            return contact_force
        turn = self._turn(q)
        wrench = self._from_client(turn) if self.use_external else np.array(contact_force)
        if self._zero is not None:
            wrench = wrench - (self._zero.reshape(2, 3) @ turn.T).ravel()
        numbers: list[float] = wrench.tolist()
        return numbers

    def _from_client(self, turn: Array) -> Array:
        force, moment = np.reshape(self._written.get("external_force_torque", ZERO6), (2, 3))
        about_tcp = moment - np.cross(self._arm.tool.offset6[:3], force)
        return np.concatenate([turn @ force, turn @ about_tcp])

    def _turn(self, q: Array) -> Array:
        turn: Array = self._arm.believed.matrix(q)[:3, :3]
        return turn
