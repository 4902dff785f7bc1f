"""The pipeline of a real device, built on stand-ins that know exactly the names of depthai's own classes.

No device can be here; a name that the library does not have, or a link that is missing, can still be found.
"""

import json
import os
import subprocess
import sys
from typing import Any

import pytest

QUIET = {"DEPTHAI_TELEMETRY": "0", "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0"}

SCRIPT = """
import json, sys
from unittest.mock import MagicMock
import depthai as dai
from drivers.oak.config import OakConfig
from drivers.oak.pipeline import oak_nodes

made = []
def create(kind):
    node = MagicMock(spec=kind, name=kind.__name__)
    if hasattr(kind, "build"):
        node.build.return_value = node
    made.append(node)
    return node

pipeline = MagicMock(spec=dai.Pipeline)
pipeline.create.side_effect = create
device = MagicMock(spec=dai.Device)
device.getPlatform.return_value = getattr(dai.Platform, sys.argv[1])
exposure = json.loads(sys.argv[2])
colour, depth = oak_nodes(pipeline, device, OakConfig(width=1280, height=720, fps=15, exposure_s=exposure))

camera, left, right, stereo = made[:4]
align = made[4] if len(made) > 4 else None
print("ANSWER" + json.dumps({
    "nodes": [type(n).__name__ if not hasattr(n, "_spec_class") else n._spec_class.__name__ for n in made],
    "sockets": [n.build.call_args.args[0].name for n in (camera, left, right)],
    "colour": [list(camera.requestOutput.call_args.args[0]), camera.requestOutput.call_args.args[1].name],
    "colour is given": colour is camera.requestOutput.return_value,
    "stereo of both": stereo.build.call_args.args == (
        left.requestOutput.return_value, right.requestOutput.return_value),
    "aligned to colour by stereo": colour.link.call_args.args[0] is stereo.inputAlignTo,
    "aligned to colour by align": align is not None and colour.link.call_args.args[0] is align.inputAlignTo,
    "depth of stereo": depth is stereo.depth,
    "depth of align": align is not None and depth is align.outputAligned,
    "stereo into align": align is not None and stereo.depth.link.call_args.args[0] is align.input,
    "manual exposure": camera.initialControl.setManualExposure.call_args is not None
        and list(camera.initialControl.setManualExposure.call_args.args),
}))
"""


def ask(platform: str, exposure_s: float | None = None) -> dict[str, Any]:
    command = [sys.executable, "-c", SCRIPT, platform, json.dumps(exposure_s)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env={**os.environ, **QUIET})
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.partition("ANSWER")[2]))


@pytest.mark.parametrize(
    ("platform", "by", "other"), [("RVC2", "stereo", "align"), ("RVC4", "align", "stereo")]
)
def test_depth_is_aligned_to_colour_in_the_way_of_each_platform(platform: str, by: str, other: str) -> None:
    found = ask(platform)
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


def test_a_fixed_exposure_is_set_in_microseconds() -> None:
    assert ask("RVC2", 0.005)["manual exposure"] == [5000, 200]
