"""Where the camera and the board are fixed, and what flange pose gives a wanted view."""

from dataclasses import dataclass
from typing import Protocol, Self

from scipy.spatial.transform import RigidTransform


class Mounting(Protocol):
    """Turns views of the board into flange poses."""

    @property
    def X(self) -> RigidTransform:
        """The camera's pose: ``T_flange_camera`` where it rides on the flange, else ``T_base_camera``."""
        ...

    def flange(self, T_camera_target: RigidTransform) -> RigidTransform:
        """``T_base_flange`` (n) from which the camera sees the board as ``T_camera_target`` (n)."""
        ...

    def view(self, T_base_flange: RigidTransform) -> RigidTransform:
        """``T_camera_target`` (n) expected at ``T_base_flange`` (n)."""
        ...


@dataclass(frozen=True, eq=False)
class EyeInHand:
    """The camera rides on the flange, the board lies in the cell."""

    T_flange_camera: RigidTransform
    T_base_target: RigidTransform

    @property
    def X(self) -> RigidTransform:
        return self.T_flange_camera

    @classmethod
    def from_view(
        cls, T_flange_camera: RigidTransform, T_base_flange: RigidTransform, T_camera_target: RigidTransform
    ) -> Self:
        """The board where it is seen now; an error of the nominal X mostly cancels in poses near by."""
        return cls(T_flange_camera, T_base_flange * T_flange_camera * T_camera_target)

    def flange(self, T_camera_target: RigidTransform) -> RigidTransform:
        return self.T_base_target * T_camera_target.inv() * self.T_flange_camera.inv()

    def view(self, T_base_flange: RigidTransform) -> RigidTransform:
        return (T_base_flange * self.T_flange_camera).inv() * self.T_base_target


@dataclass(frozen=True, eq=False)
class EyeToHand:
    """The camera stands in the cell, the arm moves the board."""

    T_base_camera: RigidTransform
    T_flange_target: RigidTransform

    @property
    def X(self) -> RigidTransform:
        return self.T_base_camera

    @classmethod
    def from_view(
        cls, T_flange_target: RigidTransform, T_base_flange: RigidTransform, T_camera_target: RigidTransform
    ) -> Self:
        """The camera where it must be to see the board as it does now."""
        return cls(T_base_flange * T_flange_target * T_camera_target.inv(), T_flange_target)

    def flange(self, T_camera_target: RigidTransform) -> RigidTransform:
        return self.T_base_camera * T_camera_target * self.T_flange_target.inv()

    def view(self, T_base_flange: RigidTransform) -> RigidTransform:
        return self.T_base_camera.inv() * T_base_flange * self.T_flange_target
