"""The depthai pipeline: two builders of sources, one consumer.

A real OAK and a frame socket both end in a ``Sync`` node that runs on the host, so everything behind it is
the same code. This module imports depthai; only the vision child imports this module.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import depthai as dai
import numpy as np
from numpy.typing import NDArray

from cell.devices import Identity, Intrinsics
from cell.errors import CellError, error
from drivers.oak.config import OakConfig
from drivers.oak.frame_socket import FrameGroup, FrameSocket

_COLOUR, _DEPTH = "colour", "depth"
_STEREO_SIZE = (640, 400)


@dataclass(frozen=True)
class Shot:
    """One synchronised exposure; arrays are copies and free of depthai."""

    seq: int
    t_exposure: float
    exposure_s: float
    intrinsics: Intrinsics
    colour: NDArray[np.uint8]  # (h, w, 3) BGR
    depth: NDArray[np.uint16] | None  # (h, w) mm, 0 = invalid


class FrameSource:
    """A running pipeline. ``fallback`` gives intrinsics where a frame does not carry valid ones."""

    def __init__(
        self,
        pipeline: Any,
        queue: Any,
        identity: Identity,
        fallback: Any = None,
        node: "FrameSocketNode | None" = None,
    ) -> None:
        self.identity = identity
        self._pipeline, self._queue, self._fallback, self._node = pipeline, queue, fallback, node

    def next(self, timeout_s: float) -> Shot | None:
        """The next exposure, None after ``timeout_s``; raises the coded error that ended the source."""
        try:
            group = self._queue.get(timedelta(seconds=timeout_s))
        except (dai.MessageQueue.QueueException, RuntimeError) as exc:
            self._raise_failure()
            raise error("CAMERA_FAULT", f"the camera's queue ended: {exc}") from exc
        if group is None:
            self._raise_failure()
            return None
        return self._shot(group)

    def _raise_failure(self) -> None:
        if self._node is not None and self._node.failure is not None:
            raise self._node.failure
        if not self._pipeline.isRunning():
            raise error("CAMERA_FAULT", "the camera's pipeline stopped")

    def _shot(self, group: Any) -> Shot:
        frame = group[_COLOUR]
        names = group.getMessageNames()
        middle = frame.getTimestamp(dai.CameraExposureOffset.MIDDLE)
        return Shot(
            seq=frame.getSequenceNum(),
            t_exposure=middle.total_seconds(),
            exposure_s=frame.getExposureTime().total_seconds(),
            intrinsics=frame_intrinsics(frame, self._fallback),
            colour=frame.getCvFrame(),
            depth=group[_DEPTH].getFrame() if _DEPTH in names else None,
        )


def frame_intrinsics(frame: Any, fallback: Any = None) -> Intrinsics:
    """Intrinsics of a ``dai.ImgFrame`` from its own transformation.

    Where the frame carries none, ``fallback`` (a ``dai.CalibrationHandler``) gives those of CAM_A at the
    frame's size. ``CAMERA_FAULT`` when neither is there, or the lens model is not OpenCV's.
    """
    width, height = frame.getWidth(), frame.getHeight()
    transformation = frame.getTransformation()
    if transformation.isValid():
        if transformation.getDistortionModel() != dai.CameraModel.Perspective:
            raise error(
                "CAMERA_FAULT", f"lens model {transformation.getDistortionModel().name} is not handled"
            )
        K, dist = transformation.getIntrinsicMatrix(), transformation.getDistortionCoefficients()
    elif fallback is not None:
        K = fallback.getCameraIntrinsics(dai.CameraBoardSocket.CAM_A, width, height)
        dist = fallback.getDistortionCoefficients(dai.CameraBoardSocket.CAM_A)
    else:
        raise error("CAMERA_FAULT", "the camera has no calibration in its memory")
    return Intrinsics(width, height, (K[0][0], K[1][1], K[0][2], K[1][2]), tuple(dist))


@contextmanager
def open_source(config: OakConfig) -> Iterator[FrameSource]:
    """A running source for ``config``; ``DEVICE_UNREACHABLE`` when there is no camera."""
    if config.socket_path is not None:
        with _frame_source(config.socket_path) as source:
            yield source
    else:
        with _oak_source(config) as source:
            yield source


# -- a real device


@contextmanager
def _oak_source(config: OakConfig) -> Iterator[FrameSource]:
    with _open_device(config) as device, dai.Pipeline(device) as pipeline:
        try:
            source = _start_oak(pipeline, device, config)
        except RuntimeError as exc:
            raise error("CAMERA_FAULT", f"{device.getDeviceId()} cannot run the pipeline: {exc}") from exc
        yield source


def _start_oak(pipeline: Any, device: Any, config: OakConfig) -> FrameSource:
    device.setMaxReconnectionAttempts(0)  # reconnecting is the supervisor's business
    device.setIrLaserDotProjectorIntensity(0.0)  # its dots disturb corners
    colour, depth = oak_nodes(pipeline, device, config)
    queue = _synchronised(pipeline, colour, depth, timedelta(seconds=0.5 / config.fps))
    identity = Identity(
        device.getProductName() or device.getDeviceName(),
        device.getDeviceId(),
        f"depthai {dai.__version__}",
        {"platform": device.getPlatformAsString()},
    )
    pipeline.start()
    return FrameSource(pipeline, queue, identity, device.readCalibration())


def _open_device(config: OakConfig) -> Any:
    try:
        if config.expect_serial is None:
            return dai.Device()
        return dai.Device(dai.DeviceInfo(config.expect_serial))
    except RuntimeError as exc:
        wanted = config.expect_serial or "any OAK"
        raise error("DEVICE_UNREACHABLE", f"{wanted} was not found on USB or network: {exc}") from exc


def oak_nodes(pipeline: Any, device: Any, config: OakConfig) -> tuple[Any, Any]:
    """Outputs of colour, and of depth aligned to it, both ``config.width`` x ``config.height``."""
    size, sockets = (config.width, config.height), dai.CameraBoardSocket
    camera = pipeline.create(dai.node.Camera).build(sockets.CAM_A)
    if config.exposure_s is not None:
        camera.initialControl.setManualExposure(round(config.exposure_s * 1e6), config.iso)
    colour = camera.requestOutput(size, dai.ImgFrame.Type.BGR888i, fps=config.fps)
    left, right = (
        pipeline.create(dai.node.Camera).build(s).requestOutput(_STEREO_SIZE, fps=config.fps)
        for s in (sockets.CAM_B, sockets.CAM_C)
    )
    stereo = pipeline.create(dai.node.StereoDepth).build(left, right)
    stereo.setLeftRightCheck(True)
    stereo.setSubpixel(True)
    if device.getPlatform() == dai.Platform.RVC4:
        align = pipeline.create(dai.node.ImageAlign)
        stereo.depth.link(align.input)
        colour.link(align.inputAlignTo)
        return colour, align.outputAligned
    stereo.setOutputSize(*size)
    colour.link(stereo.inputAlignTo)
    return colour, stereo.depth


# -- a frame socket


class FrameSocketNode(dai.node.ThreadedHostNode):
    """A camera for depthai that reads a :class:`FrameSocket`."""

    def __init__(self, socket: FrameSocket, first: FrameGroup) -> None:
        """Take over ``socket``, from which ``first`` was already read."""
        super().__init__()
        self.colour = self.createOutput()
        self.depth = self.createOutput()
        self.failure: Exception | None = None
        self.socket, self.first = socket, first

    def run(self) -> None:
        """Read until the pipeline stops. An exception that left this method would abort the process."""
        try:
            group: FrameGroup | None = self.first
            while group is not None and self.isRunning():
                self._send(group)
                group = self.socket.read()
        except CellError as exc:
            self.failure = exc
        except Exception as exc:
            self.failure = error("INTERNAL", f"frame source: {type(exc).__name__}: {exc}")

    def _send(self, group: FrameGroup) -> None:
        if group.serial != self.first.serial or (group.depth is None) != (self.first.depth is None):
            raise error("PROTOCOL_VIOLATION", f"the camera {self.first.serial} turned into {group.serial}")
        end = timedelta(seconds=group.t_exposure + 0.5 * group.exposure_s)
        self.colour.send(_image(group, group.colour, dai.ImgFrame.Type.BGR888i, end))
        if group.depth is not None:
            self.depth.send(_image(group, group.depth, dai.ImgFrame.Type.RAW16, end))


def _image(group: FrameGroup, pixels: NDArray[Any], kind: Any, end: timedelta) -> Any:
    """A ``dai.ImgFrame`` as a device would send it: stamped at the end of exposure, with its intrinsics."""
    camera = group.intrinsics
    image = dai.ImgFrame()
    image.setCvFrame(pixels, kind)
    image.setSequenceNum(group.seq)
    image.setTimestamp(end)
    image.setTimestampDevice(end)
    image.cam.exposureTimeUs = round(group.exposure_s * 1e6)
    image.setTransformation(
        dai.ImgTransformation(
            camera.width,
            camera.height,
            camera.matrix.tolist(),
            dai.CameraModel.Perspective,
            list(camera.dist),
        )
    )
    return image


@contextmanager
def _frame_source(path: str) -> Iterator[FrameSource]:
    """A pipeline fed from the socket; returns when the first group says what there is."""
    socket = FrameSocket(path)
    try:
        first = socket.read()
        if first is None:
            raise error("DEVICE_LOST", f"{path}: it was closed before the first frame")
        with dai.Pipeline(createImplicitDevice=False) as pipeline:
            node = pipeline.create(FrameSocketNode, socket, first)
            socket.running = node.isRunning
            depth = None if first.depth is None else node.depth
            queue = _synchronised(pipeline, node.colour, depth, timedelta(milliseconds=1))
            identity = Identity("OAK frame source", first.serial, f"depthai {dai.__version__}")
            pipeline.start()
            try:
                yield FrameSource(pipeline, queue, identity, node=node)
            finally:
                pipeline.stop()
                pipeline.wait()
    finally:
        socket.close()


def _synchronised(pipeline: Any, colour: Any, depth: Any | None, threshold: timedelta) -> Any:
    """Queue of groups of one exposure; it keeps the newest two, so a slow reader loses the older."""
    sync = pipeline.create(dai.node.Sync)
    sync.setRunOnHost(True)
    sync.setSyncThreshold(threshold)
    colour.link(sync.inputs[_COLOUR])
    if depth is not None:
        depth.link(sync.inputs[_DEPTH])
    return sync.out.createOutputQueue(maxSize=2, blocking=False)
