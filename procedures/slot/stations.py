"""Where the flange is to be for each thing that the job does at a slot."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from calibration.slot.rectangle import Rectangle
from cell.poses import from_pose6
from cell.run_values import RunValues
from procedures.hand_eye_in_use import require_hand_eye
from procedures.slot.config import SlotInsertionConfig


@dataclass(frozen=True)
class Stations:
    """``T_flange_camera``, and ``T_flange_part`` of a gripped part's front."""

    config: SlotInsertionConfig
    T_flange_camera: RigidTransform
    T_flange_part: RigidTransform

    @classmethod
    def of(cls, config: SlotInsertionConfig, values: RunValues) -> "Stations":
        tool = from_pose6(values.tool["T_flange_tool"])
        X = require_hand_eye(values)
        return cls(config, X, tool * from_pose6(config.part.T_tool_part))

    def opening(self) -> Rectangle:
        return Rectangle(self.config.opening.width_m, self.config.opening.height_m)

    def nominal_slot(self) -> RigidTransform:
        """``T_base_slot`` as the rack's model has it."""
        rack = self.config.rack
        return from_pose6(rack.T_base_rack) * rack.model().T_rack_slot(self.config.slot)

    def look(self, T_base_slot: RigidTransform) -> RigidTransform:
        """Where the camera sees the slot at its preset place in the picture."""
        return T_base_slot * from_pose6(self.config.look.T_slot_camera) * self.T_flange_camera.inv()

    def front_at(self, T_base_slot: RigidTransform, depth_m: float) -> RigidTransform:
        """Where a gripped part's front is ``depth_m`` in the slot, negative before it."""
        return T_base_slot * along(depth_m) * self.T_flange_part.inv()

    def among_slots(self, T_base_flange: RigidTransform) -> bool:
        """Whether a gripped part's front is, or would be, in the rack or right before it."""
        rack, near = self.config.rack, self.config.insertion.near_m
        front = from_pose6(rack.T_base_rack).inv() * T_base_flange * self.T_flange_part
        x, y, depth = front.translation
        width, height = ((rack.columns - 1) * rack.column_pitch_m, (rack.rows - 1) * rack.row_pitch_m)
        beside = max(abs(x - 0.5 * width) - 0.5 * width, abs(y - 0.5 * height) - 0.5 * height)
        within = beside < 0.5 * max(self.config.opening.width_m, self.config.opening.height_m)
        return bool(within and -2.0 * near < depth < 2.0 * self.config.opening.depth_m)

    def depth(self, T_base_slot: RigidTransform, T_base_flange: RigidTransform) -> float:
        """How deep in the slot the front of a gripped part is, m."""
        return float((T_base_slot.inv() * T_base_flange * self.T_flange_part).translation[2])


def along(distance_m: float) -> RigidTransform:
    """A step along z."""
    return RigidTransform.from_translation([0.0, 0.0, distance_m])
