"""The devices that a run works with: by role, as the kind that the role asks for."""

from collections.abc import Callable

from cell.corrected_stamps import CorrectedCamera, CorrectedEncoder
from cell.devices import Arm, DepthCamera, Device, DigitalInputs, Encoder, Gripper, ObservedArm
from cell.kinds import D, as_kind
from cell.laser_tracker import LaserTracker
from cell.modelled_arm import ArmModels, ModelledArm
from cell.run_values import RunValues


class RunDevices:
    """Devices whose stamps and flange poses are by the ``values`` of the run."""

    def __init__(
        self, ready: Callable[[str], Device], values: RunValues, arm_models: ArmModels | None = None
    ) -> None:
        """``ready(role)``: the device that plays it, or a coded error while it is not READY. ``arm_models``:
        how the arm is seen and moved when not as its controller believes."""
        self.values, self.arm_models, self._ready = values, arm_models, ready
        self._devices: dict[str, Device] = {}

    def arm(self) -> Arm:
        """The arm of this cell; its flange poses are those of the model that the run works with."""
        return self.as_modelled(self.device("arm", Arm))

    def as_modelled(self, arm: Arm) -> Arm:
        """``arm`` with flange poses of the model that the run works with."""
        return arm if self.arm_models is None else ModelledArm(arm, self.arm_models)

    def camera(self, role: str) -> DepthCamera:
        """The camera that plays ``role``, its stamps by the offset in effect."""
        camera, late_s = self.device(role, DepthCamera), self._late_s(role)
        return CorrectedCamera(camera, late_s) if late_s else camera

    def inputs(self, role: str) -> DigitalInputs:
        """The group of digital inputs that plays ``role``."""
        return self.device(role, DigitalInputs)

    def tracker(self) -> LaserTracker:
        """The laser tracker of this cell."""
        return self.device("tracker", LaserTracker)

    def observed_arm(self) -> ObservedArm:
        """The arm that this cell reads but does not move."""
        return self.device("observed_arm", ObservedArm)

    def encoder(self) -> Encoder:
        """The belt's encoder, its stamps by the offset in effect."""
        encoder, late_s = self.device("belt", Encoder), self._late_s("belt")
        return CorrectedEncoder(encoder, late_s) if late_s else encoder

    def _late_s(self, role: str) -> float:
        """By how much the stamps of ``role`` are late that its driver gives, s."""
        offset = self.values.time_offset_s.get(role)
        return 0.0 if offset is None else offset["effective"] - offset["applied"]

    def gripper(self) -> Gripper:
        """The gripper on the arm."""
        return self.device("gripper", Gripper)

    def grips_confirmed(self) -> bool:
        """Whether anything confirms what the gripper holds."""
        return self.gripper().confirms

    def device(self, role: str, protocol: type[D]) -> D:
        """The device that plays ``role``, as the kind of device that the role asks for, with its own stamps.

        Ready when it is asked for first; silent later, it says so itself where it is used.
        """
        if role not in self._devices:
            self._devices[role] = self._ready(role)
        return as_kind(self._devices[role], protocol)
