"""Intrinsics as depthai carries them, from a frame and from an EEPROM, against numbers worked out by hand."""

from typing import Any

import pytest

from tests.kit.depthai_child import answers

SCRIPT = """
import depthai as dai
from cell.errors import CellError
from drivers.oak.pipeline import frame_intrinsics

def answer(width=1280, height=800, K=None, dist=(), eeprom=None, model="Perspective"):
    image = dai.ImgFrame()
    image.setWidth(width)
    image.setHeight(height)
    handler = None
    if eeprom is not None:
        handler = dai.CalibrationHandler.fromJson(eeprom)
    if K is not None:
        image.setTransformation(dai.ImgTransformation(
            width, height, K, getattr(dai.CameraModel, model), list(dist)))
    try:
        found = frame_intrinsics(image, handler)
    except CellError as exc:
        return {"error": exc.name}
    return {"size": [found.width, found.height], "K": found.K, "dist": found.dist}
"""

NOWHERE = {"x": 0.0, "y": 0.0, "z": 0.0}
UNPLACED = {
    "lengthUnit": 1,
    "rotationMatrix": [],
    "specTranslation": NOWHERE,
    "toCameraSocket": -1,
    "toDeviceId": "",
    "translation": NOWHERE,
}
DIST = [0.25, -0.5, 0.001, -0.002, 0.125, 0.5, -0.25, 0.0625, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
EEPROM: dict[str, Any] = {
    "batchName": "",
    "batchTime": 0,
    "boardConf": "",
    "boardCustom": "",
    "boardName": "TWIN",
    "boardOptions": 0,
    "boardRev": "",
    "cameraData": [
        [
            0,
            {
                "cameraType": 0,
                "distortionCoeff": DIST,
                "extrinsics": UNPLACED,
                "height": 1080,
                "intrinsicMatrix": [[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]],
                "lensPosition": 0,
                "specHfovDeg": 0.0,
                "width": 1920,
            },
        ]
    ],
    "deviceName": "TWIN",
    "hardwareConf": "",
    "housingExtrinsics": UNPLACED,
    "imuExtrinsics": UNPLACED,
    "miscellaneousData": [],
    "productName": "TWIN",
    "stereoEnableDistortionCorrection": False,
    "stereoRectificationData": {
        "leftCameraSocket": -1,
        "rectifiedRotationLeft": [],
        "rectifiedRotationRight": [],
        "rightCameraSocket": -1,
    },
    "stereoUseSpecTranslation": True,
    "version": 7,
    "verticalCameraSocket": -1,
}
FRAME_K = [[801.0, 0.0, 644.0], [0.0, 802.0, 397.0], [0.0, 0.0, 1.0]]


CASES: dict[str, dict[str, Any]] = {
    "frame": {"K": FRAME_K, "dist": [0.25, -0.5, 0.0, 0.0, 0.125], "eeprom": EEPROM},
    "eeprom": {"eeprom": EEPROM, "width": 1280, "height": 720},
    "cropped": {"eeprom": EEPROM},
    "nothing": {},
    "fisheye": {"K": FRAME_K, "dist": [0.1, 0.0, 0.0, 0.0], "model": "Fisheye"},
}
Answers = dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def found() -> Answers:
    return answers(SCRIPT, CASES)


def test_a_frame_that_carries_its_intrinsics_is_believed_before_the_eeprom(found: Answers) -> None:
    subject = found["frame"]
    assert subject["size"] == [1280, 800]
    assert subject["K"] == [801.0, 802.0, 644.0, 397.0]
    assert subject["dist"] == [0.25, -0.5, 0.0, 0.0, 0.125]


def test_the_eeprom_gives_the_intrinsics_at_the_size_of_the_frame(found: Answers) -> None:
    subject = found["eeprom"]
    # A third fewer pixels each way: focal length and centre shrink by two thirds.
    assert subject["K"] == pytest.approx([666.6667, 666.6667, 640.0, 360.0], abs=1e-3)
    assert subject["dist"] == pytest.approx(DIST, abs=1e-7)


def test_the_eeprom_is_cropped_where_the_aspect_differs(found: Answers) -> None:
    # 1920x1080 to 1280x800: scaled by 800/1080 and cropped left and right about the centre.
    assert found["cropped"]["K"] == pytest.approx([740.7407, 740.7407, 640.0, 400.0], abs=1e-3)


def test_a_camera_without_any_calibration_is_a_fault(found: Answers) -> None:
    assert found["nothing"] == {"error": "CAMERA_FAULT"}


def test_a_lens_that_opencv_does_not_describe_is_a_fault(found: Answers) -> None:
    assert found["fisheye"] == {"error": "CAMERA_FAULT"}
