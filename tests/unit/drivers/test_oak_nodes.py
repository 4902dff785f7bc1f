"""The pipeline of a real device, built on stand-ins that know exactly the names of depthai's own classes.

No device can be here; a name that the library does not have, or a link that is missing, can still be found.
"""

from typing import Any

import pytest

from drivers.oak.config import OakConfig
from tests.kit.depthai_child import answers

SCRIPT = """
from unittest.mock import MagicMock, patch
import depthai as dai
from drivers.oak.config import OakConfig
from cell.errors import CellError
from drivers.oak.device_nodes import check_usb, colour_camera, depth_nodes, open_device

def answer(cameras, platform="RVC2", **has):
    made = []
    def create(kind):
        node = MagicMock(spec=kind, name=kind.__name__)
        if hasattr(kind, "build"):
            node.build.return_value = node
        if kind is dai.node.StereoDepth:
            node.initialConfig = dai.StereoDepthConfig()
        made.append(node)
        return node

    pipeline = MagicMock(spec=dai.Pipeline)
    pipeline.create.side_effect = create
    device = MagicMock(spec=dai.Device)
    device.getPlatform.return_value = getattr(dai.Platform, platform)
    device.getConnectedCameraFeatures.return_value = [
        MagicMock(spec=dai.CameraFeatures, socket=getattr(dai.CameraBoardSocket, name), sensorName=sensor,
                  hasAutofocus=name in has.get("autofocus", []))
        for name, sensor in cameras.items()
    ]
    device.readCalibration.return_value.getLensPosition.return_value = 135
    device.getUsbSpeed.return_value = getattr(dai.UsbSpeed, has.get("usb", "SUPER"))
    device.getDeviceId.return_value = "14442C10D13EABCE00"
    config = OakConfig(width=1280, height=720, fps=15, **has.get("config", {}))
    try:
        check_usb(device, config)
        refused = None
    except CellError as exc:
        refused = exc.detail
    seen = colour_camera(pipeline, device, config)
    colour, depth = seen.output, depth_nodes(pipeline, device, seen.output, config)

    made += [None] * (4 - len(made))
    camera, left, right, stereo = made[:4]
    focus = camera.initialControl.setManualFocus.call_args
    with patch.object(dai, "Device") as opened:
        open_device(config)
    wanted = opened.call_args.args
    told = {
        "opened": [wanted[0].name, wanted[0].deviceId] if wanted else None,
        "row_time_s": seen.row_time_s,
        "focus": focus and focus.args[0],
        "watched": seen.lens and seen.lens.wanted,
        "refused": refused,
        "preset": stereo and stereo.setDefaultProfilePreset.call_args
            and stereo.setDefaultProfilePreset.call_args.args[0].name,
        "manual exposure": camera.initialControl.setManualExposure.call_args is not None
            and list(camera.initialControl.setManualExposure.call_args.args),
        "depth": depth is not None,
    }
    if depth is None:
        return told
    align = made[4] if len(made) > 4 else None
    chosen = stereo.initialConfig
    after = chosen.postProcessing
    return told | {
        "matched": [list(n.requestOutput.call_args.args[0]) for n in (left, right)],
        "bits": stereo.setSubpixelFractionalBits.call_args
            and stereo.setSubpixelFractionalBits.call_args.args[0],
        "median": chosen.getMedianFilter().name,
        "confidence": chosen.getConfidenceThreshold(),
        "filters": [n for n in ("speckle", "spatial", "temporal") if getattr(after, n + "Filter").enable],
        "nodes": [getattr(n, "_spec_class", type(n)).__name__ for n in made],
        "sockets": [n.build.call_args.args[0].name for n in (camera, left, right)],
        "colour": [list(camera.requestOutput.call_args.args[0]), camera.requestOutput.call_args.args[1].name],
        "colour is given": colour is camera.requestOutput.return_value,
        "stereo of both": stereo.build.call_args.args == (
            left.requestOutput.return_value, right.requestOutput.return_value),
        "aligned to colour by stereo": colour.link.call_args.args[0] is stereo.inputAlignTo,
        "aligned to colour by align": align is not None
            and colour.link.call_args.args[0] is align.inputAlignTo,
        "depth of stereo": depth is stereo.depth,
        "depth of align": align is not None and depth is align.outputAligned,
        "stereo into align": align is not None and stereo.depth.link.call_args.args[0] is align.input,
    }
"""


OAK_D = {"CAM_A": "IMX378", "CAM_B": "OV9282", "CAM_C": "OV9282"}
CASES: dict[str, dict[str, Any]] = {
    "RVC2": {"cameras": OAK_D},
    "RVC4": {"cameras": OAK_D, "platform": "RVC4"},
    "exposure": {"cameras": OAK_D, "config": {"exposure_s": 0.005}},
    "autofocus": {"cameras": OAK_D, "autofocus": ["CAM_A"], "config": {"stereo_preset": "robotics"}},
    "fixed focus": {"cameras": OAK_D | {"CAM_A": "OV9782"}, "config": {"focus": 80}},
    "no stereo": {"cameras": {"CAM_A": "a new sensor"}, "usb": "HIGH"},
    "unwanted": {"cameras": OAK_D, "config": {"depth": False}},
    "chosen": {
        "cameras": OAK_D,
        "config": {
            "stereo_height": 800,
            "stereo_median": "5x5",
            "stereo_filters": ["speckle", "temporal"],
            "stereo_confidence": 55,
        },
    },
    "fine": {"cameras": OAK_D, "config": {"stereo_subpixel_bits": 5, "stereo_filters": []}},
    "by serial": {"cameras": OAK_D, "config": {"expect_serial": "14442C10D13EABCE00"}},
    "on a network": {"cameras": OAK_D, "config": {"host": "10.0.0.5", "expect_serial": "14442C10D13EABCE00"}},
}
Answers = dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def answered() -> Answers:
    return answers(SCRIPT, CASES)


@pytest.mark.parametrize(
    ("platform", "by", "other"), [("RVC2", "stereo", "align"), ("RVC4", "align", "stereo")]
)
def test_depth_is_aligned_to_colour_in_the_way_of_each_platform(
    platform: str, by: str, other: str, answered: Answers
) -> None:
    found = answered[platform]
    assert found["nodes"][:4] == ["Camera", "Camera", "Camera", "StereoDepth"]
    assert found["sockets"] == ["CAM_A", "CAM_B", "CAM_C"]
    assert found["colour"] == [[1280, 720], "BGR888i"]
    assert found["colour is given"]
    assert found["stereo of both"]
    assert found[f"aligned to colour by {by}"]
    assert not found[f"aligned to colour by {other}"]
    assert found[f"depth of {by}"]
    assert found["stereo into align"] == (by == "align")
    assert found["manual exposure"] is False


def test_an_oak_is_opened_by_its_address_or_by_its_serial_number(answered: Answers) -> None:
    assert answered["RVC2"]["opened"] is None
    assert answered["by serial"]["opened"] == ["", "14442C10D13EABCE00"]
    assert answered["on a network"]["opened"] == ["10.0.0.5", ""]


def test_size_steps_and_filters_of_the_pair_are_those_of_the_configuration(answered: Answers) -> None:
    usual, chosen, fine = answered["RVC2"], answered["chosen"], answered["fine"]
    assert (usual["matched"], usual["bits"]) == ([[640, 400]] * 2, None)
    assert chosen["matched"] == [[1280, 800]] * 2
    assert (chosen["median"], chosen["confidence"]) == ("KERNEL_5x5", 55)
    assert chosen["filters"] == ["speckle", "temporal"]
    # With more than three bits the device has no median filter.
    assert (fine["bits"], fine["median"], fine["filters"]) == (5, "MEDIAN_OFF", [])
    with pytest.raises(ValueError, match="works on 3 subpixel bits"):
        OakConfig(stereo_subpixel_bits=4, stereo_median="7x7")  # type: ignore[call-arg]
    with pytest.raises(ValueError, match="depth = false has no use for stereo_height"):
        OakConfig(depth=False, stereo_height=800)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match="host is the address of an OAK"):
        OakConfig(source="frames+unix:///run/camera", host="10.0.0.5")  # type: ignore[call-arg]


def test_a_fixed_exposure_is_set_in_microseconds(answered: Answers) -> None:
    assert answered["exposure"]["manual exposure"] == [5000, 200]


def test_a_lens_that_can_move_is_put_where_it_was_calibrated_and_watched(answered: Answers) -> None:
    found = answered["autofocus"]
    assert (found["focus"], found["watched"]) == (135, 135)
    assert found["row_time_s"] == pytest.approx(0.0167 / 720)
    assert found["preset"] == "ROBOTICS"
    fixed = answered["fixed focus"]
    assert (fixed["focus"], fixed["watched"], fixed["row_time_s"]) == (None, None, 0.0)


def test_a_device_without_a_stereo_pair_gives_colour_alone_and_a_slow_cable_is_refused(
    answered: Answers,
) -> None:
    assert not answered["unwanted"]["depth"]
    found = answered["no stereo"]
    assert not found["depth"]
    assert found["row_time_s"] is None
    assert "use a USB 3 cable" in found["refused"]
    assert "41 MB/s" in found["refused"]
