"""The place where items are put down: each lies there until it is carried off."""

from fakes.world.belt.gripper import Gripper
from fakes.world.belt.item_truth import PlaceTruth


class Place:
    """What lies where ``gripper`` has put items down, at times in s on the twin's clock."""

    def __init__(self, truth: PlaceTruth, gripper: Gripper) -> None:
        self.truth, self._gripper = truth, gripper
        self._blocked: list[float] = []

    def block(self, t: float) -> None:
        """Something else is put there at ``t``, and carried off as items are."""
        self._blocked.append(t)

    def lying(self, t: float) -> int:
        """How many things lie there at ``t``."""
        self._gripper.settle(t)
        since = [*(put.t for put in self._gripper.put_down), *self._blocked]
        return sum(put <= t < put + self.truth.carried_off_s for put in since)
