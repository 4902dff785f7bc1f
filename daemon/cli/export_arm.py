"""A calibrated arm for other programs: ur_description's kinematics, URDF, Universal Robots' table."""

import hashlib
from dataclasses import replace
from typing import Any

import numpy as np

from calibration.identification.exports import UR_WARNING, last_to_flange, ros_kinematics, ur_deltas
from calibration.identification.exports import urdf as chain_urdf
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import ArmSpec, arm_spec
from calibration.kinematics.ur_models import JOINT_LIMITS
from cell.formats.robot import parse_robot
from daemon.cli.export_source import Exported

_PLACES = 500
_DELTAS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")  # in the order of UR's own file


def spec_of(exported: Exported) -> ArmSpec:
    """The arm; ``DATA_INVALID`` when the ledger's ROBOT cannot be read."""
    return arm_spec(parse_robot(exported.robot, exported.name), exported.name)


def ros(exported: Exported) -> tuple[list[str], dict[str, Any]]:
    """Comment lines, and what ``ur_description`` reads as ``kinematics_params`` (xacro: the whole file)."""
    chain = spec_of(exported).arm.base
    joints, rest = ros_kinematics(chain), last_to_flange(chain)
    fingerprint = hashlib.sha256(repr(joints).encode()).hexdigest()[:16]
    comments = [
        f"for ur_description: xacro ur.urdf.xacro ur_type:={exported.ur_model} kinematics_params:=THIS_FILE",
        "The driver will say that the hash is not the controller's: it is not, this is another calibration.",
        "no program reads wrist_3_to_tool0: ur_description has no place for it. Add it as a fixed joint, "
        "or the flange is off by it.",
    ]
    return [*comments, *_left_out(chain)], {
        "kinematics": {**joints, "hash": f"cellward_{fingerprint}"},
        "wrist_3_to_tool0": rest,
    }


def urdf(exported: Exported) -> tuple[list[str], str]:
    """Comment lines, and frames and joints from ``base`` to ``flange`` and the reflectors on it."""
    spec = spec_of(exported)
    is_ur = exported.ur_model is not None
    comments = ["frames and joints alone: no meshes, no masses"]
    if not is_ur:
        comments.append("the limits are placeholders of one turn each way: set the arm's own")
    chain = spec.arm.base
    return [*comments, *_left_out(chain)], chain_urdf(
        chain, exported.name, spec.tools, JOINT_LIMITS if is_ur else None
    )


def ur_calibration(exported: Exported) -> tuple[list[str], list[str]]:
    """Comment lines, and the deltas under the names of ``calibration.conf``, without its check sums."""
    model = str(exported.ur_model)
    chain = spec_of(exported).arm.base
    deltas = ur_deltas(chain, model)
    comments = [
        f"WARNING: {UR_WARNING}",
        f"Added to the published DH table of the {model}. delta_d of joints 2 and 3 may be hundreds of "
        "metres: their axes are almost parallel.",
    ]
    lines = [f"{key} = [{', '.join(repr(float(v)) for v in getattr(deltas, key))}]" for key in _DELTAS]
    return [*comments, *_left_out(chain)], ["[mounting]", *lines]


def _left_out(chain: SerialChain) -> list[str]:
    """That this form has no place for errors of gears and sag, and how far the flange is off without them."""
    if chain.errors is None:
        return []
    Q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_PLACES, chain.joints))
    without = replace(chain, errors=None)
    apart = np.linalg.norm(chain.flange(Q)[:, :3, 3] - without.flange(Q)[:, :3, 3], axis=1)
    return [
        f"WARNING: errors of gears and sag have no place in this form; without them the flange is "
        f"{1e3 * np.sqrt(np.mean(apart**2)):.3f} mm off (RMS over all joint angles)"
    ]
