"""The depthai pipeline: two builders of sources, one consumer.

A real OAK and a frame socket both end in a ``Sync`` node that runs on the host, so everything behind it is
the same code. This module imports depthai; only the vision child imports this module.
"""

from collections.abc import Callable, Iterator
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
from drivers.oak.device_nodes import check_usb, colour_camera, depth_nodes, open_device
from drivers.oak.frame_socket import FrameGroup, FrameSocket
from drivers.oak.lens import LensWatch

_COLOUR, _DEPTH = "colour", "depth"


@dataclass(frozen=True)
class Shot:
    """One synchronised exposure; arrays are copies and free of depthai."""

    seq: int
    t_exposure: float
    exposure_s: float
    intrinsics: Intrinsics
    colour: NDArray[np.uint8]  # (h, w, 3) BGR
    depth: NDArray[np.uint16] | None  # (h, w) mm, 0 = invalid
    row_time_s: float = 0.0


class FrameSource:
    """A running pipeline. ``fallback`` gives intrinsics where a frame does not carry valid ones."""

    def __init__(
        self,
        pipeline: Any,
        queue: Any,
        identity: Identity,
        fallback: Any = None,
        node: "FrameSocketNode | None" = None,
        row_time_s: float = 0.0,
        lens: LensWatch | None = None,
        light: Callable[[bool], Any] = lambda _: None,
    ) -> None:
        """``lens`` is None where it cannot move; ``light`` switches a projector of dots."""
        self.identity, self._row_time_s = identity, row_time_s
        self._lens, self._light, self._lit = lens, light, False
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
        position = group[_COLOUR].getLensPosition()
        if self._lens is not None and not self._lens.usable(None if position < 0 else position):
            return None
        return self._shot(group)

    def light(self, wanted: bool) -> None:
        """Project dots for the stereo pair, or none: plain things need them, and they disturb corners."""
        if wanted is not self._lit:
            self._light(wanted)
            self._lit = wanted

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
            row_time_s=self._row_time_s,
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
        with _frame_source(config.socket_path, config) as source:
            yield source
    else:
        with _oak_source(config) as source:
            yield source


# -- a real device


@contextmanager
def _oak_source(config: OakConfig) -> Iterator[FrameSource]:
    with open_device(config) as device, dai.Pipeline(device) as pipeline:
        try:
            source = _start_oak(pipeline, device, config)
        except RuntimeError as exc:
            raise error("CAMERA_FAULT", f"{device.getDeviceId()} cannot run the pipeline: {exc}") from exc
        yield source


def _start_oak(pipeline: Any, device: Any, config: OakConfig) -> FrameSource:
    device.setMaxReconnectionAttempts(0)  # reconnecting is the supervisor's business
    check_usb(device, config)
    camera = colour_camera(pipeline, device, config)
    depth = depth_nodes(pipeline, device, camera.output, config)
    queue = _synchronised(pipeline, camera.output, depth, timedelta(seconds=config.group_within_s))
    identity = Identity(
        device.getProductName() or device.getDeviceName(),
        device.getDeviceId(),
        f"depthai {dai.__version__}, {camera.words}, USB {device.getUsbSpeed().name}",
        {"platform": device.getPlatformAsString()},
    )
    pipeline.start()
    return FrameSource(
        pipeline,
        queue,
        identity,
        device.readCalibration(),
        row_time_s=camera.row_time_s or 0.0,
        lens=camera.lens,
        light=lambda on: device.setIrLaserDotProjectorIntensity(config.dot_projector if on else 0.0),
    )


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


def _row_time(config: OakConfig, first: FrameGroup) -> float:
    return first.row_time_s if config.row_time_s is None else config.row_time_s


def _image(group: FrameGroup, pixels: NDArray[Any], kind: Any, end: timedelta) -> Any:
    """A ``dai.ImgFrame`` as a device would send it: stamped at the end of exposure, with its intrinsics."""
    camera = group.intrinsics
    image = dai.ImgFrame()
    image.setCvFrame(pixels, kind)
    image.setSequenceNum(group.seq)
    image.setTimestamp(end)
    image.setTimestampDevice(end)
    image.cam.lensPosition = -1 if group.lens_position is None else group.lens_position
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
def _frame_source(path: str, config: OakConfig) -> Iterator[FrameSource]:
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
                yield FrameSource(
                    pipeline, queue, identity, None, node, _row_time(config, first), LensWatch(config.focus)
                )
            finally:
                pipeline.stop()
                pipeline.wait()
    finally:
        socket.close()


def _synchronised(pipeline: Any, colour: Any, depth: Any | None, threshold: timedelta) -> Any:
    """Queue of groups of one exposure; it keeps the newest alone, so a slow reader loses the older.

    One that waits behind another would only be older when it is looked at.
    """
    sync = pipeline.create(dai.node.Sync)
    sync.setRunOnHost(True)
    sync.setSyncThreshold(threshold)
    colour.link(sync.inputs[_COLOUR])
    if depth is not None:
        depth.link(sync.inputs[_DEPTH])
    return sync.out.createOutputQueue(maxSize=1, blocking=False)
