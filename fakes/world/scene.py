"""Where flange, camera and target truly are at one moment."""

from dataclasses import dataclass
from functools import cached_property

from scipy.spatial.transform import RigidTransform

from cell.poses import Array, compose


@dataclass(frozen=True, eq=False)
class Scene:
    """What is truly where at ``t``; ``None`` while the target is not in the cell.

    ``flange`` (4, 4) in the base, ``camera`` and ``target`` in what carries them: the flange has the camera
    of an eye in hand and else the target.
    """

    t: float
    placement: int | None
    flange: Array
    camera: RigidTransform
    target: RigidTransform | None
    eye_in_hand: bool

    @cached_property
    def T_base_flange(self) -> RigidTransform:
        return RigidTransform(self.flange, normalize=False)

    @cached_property
    def T_base_camera(self) -> RigidTransform:
        return compose(self.T_base_flange, self.camera) if self.eye_in_hand else self.camera

    @cached_property
    def T_base_target(self) -> RigidTransform | None:
        if self.target is None or self.eye_in_hand:
            return self.target
        return compose(self.T_base_flange, self.target)

    @cached_property
    def T_camera_target(self) -> RigidTransform | None:
        if self.target is None:
            return None
        camera, target = self.camera.as_matrix(), self.target.as_matrix()
        if self.eye_in_hand:
            camera = self.flange @ camera
        else:
            target = self.flange @ target
        target[:3, 3] -= camera[:3, 3]
        target[:3] = camera[:3, :3].T @ target[:3]
        return RigidTransform(target, normalize=False, copy=False)
