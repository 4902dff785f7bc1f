"""What of a real OAK the pipeline is made of: its colour camera, its stereo pair, and the cable to it.

This module imports depthai; only the vision child imports this module.
"""

from dataclasses import dataclass
from typing import Any

import depthai as dai

from cell.errors import error
from drivers.oak.config import OakConfig
from drivers.oak.lens import LensWatch
from drivers.oak.shutter import row_time_s

_STEREO_WIDTH = {400: 640, 720: 1280, 800: 1280}  # of the sensors of OAK's pairs, by height
_BYTES_A_PIXEL, _OF_DEPTH = 3, 2  # BGR888i, and 16 bit
# What is left of 480 Mbit/s with USB's own overhead; an assumption on the safe side.
_USB2_BYTES_S = 35e6
_SLOW = ("LOW", "FULL", "HIGH")


@dataclass(frozen=True)
class ColourCamera:
    """Its ``output``, and what is known of it; ``row_time_s`` is None where the sensor is not known."""

    output: Any
    sensor: str
    row_time_s: float | None
    lens: LensWatch | None  # None: it cannot move

    @property
    def words(self) -> str:
        """The sensor and its shutter."""
        if self.row_time_s is None:
            return f"{self.sensor} with an unknown shutter, taken as a global one: give row_time_s"
        shutter = f"{1e6 * self.row_time_s:.1f} us a row" if self.row_time_s else "global shutter"
        return f"{self.sensor} with {shutter}"


def open_device(config: OakConfig) -> Any:
    """The OAK at the address or with the expected serial number, or any; ``DEVICE_UNREACHABLE`` when there is
    none."""
    wanted = config.host or config.expect_serial
    try:
        return dai.Device() if wanted is None else dai.Device(dai.DeviceInfo(wanted))
    except RuntimeError as exc:
        wanted = wanted or "any OAK"
        raise error("DEVICE_UNREACHABLE", f"{wanted} was not found on USB or network: {exc}") from exc


def check_usb(device: Any, config: OakConfig) -> None:
    """``CAMERA_FAULT`` when the pictures that are asked for do not fit the cable."""
    speed, depth = device.getUsbSpeed().name, _pair_of(device) if config.depth else None
    a_pixel = _BYTES_A_PIXEL + (_OF_DEPTH if depth else 0)
    needs = config.width * config.height * a_pixel * config.fps
    if speed in _SLOW and needs > _USB2_BYTES_S:
        raise error(
            "CAMERA_FAULT",
            f"{device.getDeviceId()} is on USB 2 ({speed}), which carries about "
            f"{_USB2_BYTES_S / 1e6:.0f} MB/s, and {config.width} x {config.height} at {config.fps:g} a "
            f"second are {needs / 1e6:.0f} MB/s: "
            "use a USB 3 cable and port, or lower fps, width or height",
        )


def colour_camera(pipeline: Any, device: Any, config: OakConfig) -> ColourCamera:
    """The colour camera at ``config.width`` x ``config.height``, its lens fixed where it was calibrated."""
    socket = dai.CameraBoardSocket.CAM_A
    features = _features(device).get(socket)
    if features is None:
        raise error("CAMERA_FAULT", f"{device.getDeviceId()} has no camera on {socket.name}")
    camera = pipeline.create(dai.node.Camera).build(socket)
    lens = None
    if features.hasAutofocus:
        position = device.readCalibration().getLensPosition(socket) if config.focus is None else config.focus
        camera.initialControl.setManualFocus(position)
        lens = LensWatch(position)
    if config.exposure_s is not None:
        camera.initialControl.setManualExposure(round(config.exposure_s * 1e6), config.iso)
    known = row_time_s(features.sensorName, config.height)
    return ColourCamera(
        camera.requestOutput((config.width, config.height), dai.ImgFrame.Type.BGR888i, fps=config.fps),
        features.sensorName,
        known if config.row_time_s is None else config.row_time_s,
        lens,
    )


def depth_nodes(pipeline: Any, device: Any, colour: Any, config: OakConfig) -> Any | None:
    """The output of depth aligned to ``colour``; None of a device without a stereo pair, or unwanted."""
    pair = _pair_of(device) if config.depth else None
    if pair is None:
        return None
    size = (_STEREO_WIDTH[config.stereo_height], config.stereo_height)
    left, right = (
        pipeline.create(dai.node.Camera).build(s).requestOutput(size, fps=config.fps) for s in pair
    )
    stereo = pipeline.create(dai.node.StereoDepth).build(left, right)
    _match(stereo, config)
    if device.getPlatform() == dai.Platform.RVC4:
        align = pipeline.create(dai.node.ImageAlign)
        stereo.depth.link(align.input)
        colour.link(align.inputAlignTo)
        return align.outputAligned
    stereo.setOutputSize(config.width, config.height)
    colour.link(stereo.inputAlignTo)
    return stereo.depth


def _match(stereo: Any, config: OakConfig) -> None:
    """How pictures are matched: a preset first, as it would overwrite what is chosen beside it."""
    if config.stereo_preset is not None:
        stereo.setDefaultProfilePreset(getattr(dai.node.StereoDepth.PresetMode, config.stereo_preset.upper()))
    stereo.setLeftRightCheck(True)
    stereo.setSubpixel(True)
    if config.stereo_subpixel_bits is not None:
        stereo.setSubpixelFractionalBits(config.stereo_subpixel_bits)
    chosen, kinds = stereo.initialConfig, dai.StereoDepthConfig.MedianFilter
    # The device has the median for three bits alone, and some presets ask for it.
    median = config.stereo_median if config.stereo_subpixel_bits in (None, 3) else "off"
    if median is not None:
        chosen.setMedianFilter(kinds.MEDIAN_OFF if median == "off" else getattr(kinds, f"KERNEL_{median}"))
    if config.stereo_confidence is not None:
        chosen.setConfidenceThreshold(config.stereo_confidence)
    if config.stereo_filters is not None:
        after = chosen.postProcessing
        after.speckleFilter.enable = "speckle" in config.stereo_filters
        after.spatialFilter.enable = "spatial" in config.stereo_filters
        after.temporalFilter.enable = "temporal" in config.stereo_filters


def _pair_of(device: Any) -> tuple[Any, Any] | None:
    there, sockets = _features(device), dai.CameraBoardSocket
    pair = sockets.CAM_B, sockets.CAM_C
    return pair if all(socket in there for socket in pair) else None


def _features(device: Any) -> dict[Any, Any]:
    return {features.socket: features for features in device.getConnectedCameraFeatures()}
