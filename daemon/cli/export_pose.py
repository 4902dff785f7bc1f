"""A pose for other programs: URScript, a ROS transform, a URDF joint.

ROS names differ from ours: what UR's controller and this program call the flange is ``tool0`` there; ROS' own
``flange`` is turned against it. ``base`` is the controller's base in both.
"""

import re
import shlex
from typing import Any

from calibration.identification.exports import urdf_fixed
from cell.errors import present
from cell.poses import from_pose6
from daemon.cli.export_source import Exported

_ROS_FRAME = {"flange": "tool0"}


def quaternion(exported: Exported) -> list[float]:
    """x, y, z, w with w not negative."""
    q = from_pose6(exported.value).rotation.as_quat(canonical=True)
    return [float(v) for v in q]


def ros_frames(exported: Exported) -> tuple[str, str]:
    """Parent and child under the names of ROS; a tool's frame has the tool's name."""
    parent, child = present(exported.frames, f"pose in {exported.name}")
    own = exported.name.partition(".")[2]
    return _ROS_FRAME.get(parent, parent), own or _ROS_FRAME.get(child, child)


def urscript(exported: Exported) -> list[str]:
    """An assignment; of a tool also the call that puts it into effect."""
    name = re.sub(r"\W", "_", exported.name)
    numbers = ", ".join(repr(float(v)) for v in exported.value)
    lines = [f"{name} = p[{numbers}]"]
    if exported.frames == ("flange", "tool"):
        lines.append(f"set_tcp({name})")
    elif exported.frames == ("flange", "camera"):
        lines.insert(0, f"# in the base: pose_trans(get_actual_tool_flange_pose(), pose_trans({name}, seen))")
    elif exported.frames == ("base", "camera"):
        lines.insert(0, f"# in the base: pose_trans({name}, seen)")
    return lines


def ros(exported: Exported) -> tuple[list[str], dict[str, Any]]:
    """Comment lines, and ``geometry_msgs/TransformStamped`` without its stamp."""
    x, y, z = (float(v) for v in exported.value[:3])
    q = dict(zip("xyzw", quaternion(exported), strict=True))
    parent, child = ros_frames(exported)
    numbers = {"x": x, "y": y, "z": z, **{f"q{k}": v for k, v in q.items()}}
    words = [word for key, v in numbers.items() for word in (f"--{key}", repr(v))]
    words += ["--frame-id", parent, "--child-frame-id", child]
    comments = [f"ros2 run tf2_ros static_transform_publisher {shlex.join(words)}"]
    if parent == "tool0":
        comments.append("tool0 of ur_description is the flange of the controller and of this program")
    return comments, {
        "header": {"frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": q},
    }


def urdf(exported: Exported) -> str:
    """A fixed joint between two links, in a file of its own."""
    parent, child = ros_frames(exported)
    return urdf_fixed(exported.name, parent, child, from_pose6(exported.value).as_matrix())
