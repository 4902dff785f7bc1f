"""A calibrated arm in the forms of others: ROS, URDF, and Universal Robots' own table.

A link of ours is ``Rz(q + theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)``; a joint of ROS has a fixed origin and then
turns about z. The origin of joint i is therefore what follows the turn of joint i - 1, up to the constant
part of joint i's own turn and shift.
"""

from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import ur_chain
from calibration.kinematics.hayati import in_dh_form
from calibration.kinematics.ur import DhDeltas
from cell.poses import Array

UR_JOINTS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
UR_WARNING = (
    "These deltas are for programs that read Universal Robots' calibration.conf. Do not write them to a "
    "controller: its own file carries check sums and belongs to the maker's calibration. The tracker cannot "
    "tell delta_theta and delta_d of joint 1 from the place of the base, nor the last link from the tool."
)


def ros_kinematics(chain: SerialChain) -> dict[str, dict[str, float]]:
    """Joint origins under the names of ``ur_description``'s ``default_kinematics.yaml``; m and rad.

    Six turning joints. What follows the last joint is :func:`last_to_flange`.
    """
    origins = _origins(chain)
    return {name: _origin(T) for name, T in zip(UR_JOINTS, origins[:-1], strict=True)}


def last_to_flange(chain: SerialChain) -> dict[str, float]:
    """From the frame of the last joint to the flange: not zero after a calibration, and not in ROS' file."""
    return _origin(_origins(chain)[-1])


def ur_deltas(chain: SerialChain, model: str) -> DhDeltas:
    """The chain as deltas to the published DH table of a UR ``model``.

    Pure DH: ``delta_d`` of joints 2 and 3 may be hundreds of metres, because their axes are almost parallel.
    See ``UR_WARNING``.
    """
    nominal, pure = ur_chain(model), in_dh_form(chain)
    return DhDeltas(
        delta_theta=pure.theta - nominal.theta,
        delta_d=pure.d - nominal.d,
        delta_a=pure.a - nominal.a,
        delta_alpha=pure.alpha - nominal.alpha,
    )


def urdf(chain: SerialChain, name: str, tools: Mapping[str, Array], limits: Array | None = None) -> str:
    """A URDF of frames and joints; no meshes, no masses. ``limits`` (j, 2) of the controller's joints.

    A link that follows several motors gets one mimicking joint for each. The variable of a joint is the
    angle of its link: where a motor is geared, the comment beside the joint says by how much.
    """
    m = len(chain.theta)
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(name)}>", '  <link name="base"/>']
    origins, parent = _origins(chain), "base"
    leader: dict[int, tuple[str, float]] = {}
    for i in range(m):
        drivers = [int(j) for j in np.flatnonzero(chain.coupling[i])]
        origin = origins[i]
        for k, j in enumerate(drivers or [-1]):
            last = k == len(drivers or [-1]) - 1
            child = f"link_{i + 1}" if last else f"link_{i + 1}_{k + 1}"
            joint = f"joint_{i + 1}" if len(drivers) < 2 else f"joint_{i + 1}_{k + 1}"
            body = [_origin_xml(origin), f'<parent link="{parent}"/>', f'<child link="{child}"/>']
            if j < 0:
                kind = "fixed"
            else:
                kind = "prismatic" if chain.sliding[i] else "revolute"
                ratio = float(chain.coupling[i, j])
                body += _moving_xml(joint, j, ratio, leader, limits)
            lines.append(f'  <link name="{child}"/>')
            lines.append(f'  <joint name="{joint}" type="{kind}">')
            lines += [f"    {line}" for line in body]
            lines.append("  </joint>")
            parent, origin = child, np.eye(4)
    lines += _fixed("flange", origins[-1], parent)
    for tool, place in tools.items():
        T = np.eye(4)
        T[:3, 3] = place
        lines += _fixed(tool, T, "flange")
    return "\n".join([*lines, "</robot>", ""])


def urdf_fixed(name: str, parent: str, child: str, T: Array) -> str:
    """A URDF of two links and the fixed joint between them; ``T`` (4, 4) is the child in the parent."""
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            f"<robot name={quoteattr(name)}>",
            f"  <link name={quoteattr(parent)}/>",
            *_fixed(child, T, parent),
            "</robot>",
            "",
        ]
    )


def _moving_xml(
    joint: str, j: int, ratio: float, leader: dict[int, tuple[str, float]], limits: Array | None
) -> list[str]:
    body = ['<axis xyz="0 0 1"/>']
    low, high = (-2.0 * np.pi, 2.0 * np.pi) if limits is None else sorted(float(v) for v in ratio * limits[j])
    body.append(f'<limit lower="{low:.12g}" upper="{high:.12g}" effort="0" velocity="0"/>')
    if j in leader:
        first, own = leader[j]
        body.append(f'<mimic joint="{first}" multiplier="{ratio / own:.15g}" offset="0"/>')
    else:
        leader[j] = (joint, ratio)
        if ratio != 1.0:
            body.append(f"<!-- {ratio:.15g} times motor {j + 1} -->")
    return body


def _fixed(name: str, T: Array, parent: str) -> list[str]:
    return [
        f"  <link name={quoteattr(name)}/>",
        f'  <joint name={quoteattr(name + "_fixed")} type="fixed">',
        f"    {_origin_xml(T)}",
        f"    <parent link={quoteattr(parent)}/>",
        f"    <child link={quoteattr(name)}/>",
        "  </joint>",
    ]


def _origins(chain: SerialChain) -> list[Array]:
    """Fixed transforms (4, 4) before every joint, and the one after the last."""
    m = len(chain.theta)
    out, carried = [], np.eye(4)
    for i in range(m):
        before = np.eye(4)
        before[:3, :3] = Rotation.from_rotvec([0.0, 0.0, chain.theta[i]]).as_matrix()
        before[2, 3] = chain.d[i]
        out.append(carried @ before)
        after = np.eye(4)
        after[:3, :3] = (
            Rotation.from_rotvec([chain.alpha[i], 0.0, 0.0]) * Rotation.from_rotvec([0.0, chain.beta[i], 0.0])
        ).as_matrix()
        after[0, 3] = chain.a[i]
        carried = after
    return [*out, carried]


def _origin(T: Array) -> dict[str, float]:
    roll, pitch, yaw = _rpy(T)
    x, y, z = (float(v) for v in T[:3, 3])
    return {"x": x, "y": y, "z": z, "roll": roll, "pitch": pitch, "yaw": yaw}


def _rpy(T: Array) -> Sequence[float]:
    """Fixed axes x, y, z, as URDF has them; without a warning where pitch is a quarter turn."""
    R = T[:3, :3]
    pitch = float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-12:
        return float(np.arctan2(-R[1, 2], R[1, 1])), pitch, 0.0
    return float(np.arctan2(R[2, 1], R[2, 2])), pitch, float(np.arctan2(R[1, 0], R[0, 0]))


def _origin_xml(T: Array) -> str:
    xyz = " ".join(f"{v:.15g}" for v in T[:3, 3])
    rpy = " ".join(f"{v:.15g}" for v in _rpy(T))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'
