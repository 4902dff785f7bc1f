"""How far the joints of a palletizer turn beyond what they read: by their gears, and under its weight.

As of the other arm (:mod:`fakes.world.arm.joint_errors`): a gear has a wave once and one twice a turn of its
link; the motors of upper arm and forearm give way with the cosine of the loaded links' elevations.
"""

import numpy as np

from fakes.world.arm.joint_errors import JointErrors
from fakes.world.arm.truth import JointErrorsTruth
from fakes.world.palletizer.linkage import JOINTS, Palletizer

_DRAWN_FOR = 0x9A17  # keeps these draws apart from others of the same seed


def palletizer_joint_errors(truth: JointErrorsTruth, arm: Palletizer, seed: int) -> JointErrors | None:
    """Those of a scenario for ``arm``; None where the scenario has none."""
    if not (truth.gear_once_rad or truth.gear_twice_rad or any(truth.sag_rad)):
        return None
    ratios = np.array([arm.k1, arm.k2, arm.k3, arm.k5])
    phases = np.random.default_rng([seed, _DRAWN_FOR]).uniform(0.0, 2.0 * np.pi, (JOINTS, 2))
    one = np.diag(np.abs(ratios))
    rows = [
        (f"gear{j + 1}.{times}", j, times * one[j], size * np.cos(phase), size * np.sin(phase))
        for j in range(JOINTS)
        for times, size, phase in zip(
            (1, 2), (truth.gear_once_rad, truth.gear_twice_rad), phases[j], strict=True
        )
    ]
    upper = np.array([0.0, arm.k2, 0.0, 0.0])
    fore = np.array([0.0, arm.k2, arm.k3, 0.0])
    for name, joint, row, zero, size in (
        ("sag2.upper", 1, upper, arm.t2, truth.sag_rad[0]),
        ("sag2.fore", 1, fore, arm.t2 + arm.t3, truth.sag_rad[1]),
        ("sag3.fore", 2, fore, arm.t2 + arm.t3, truth.sag_rad[2]),
    ):
        # A link sinks, whichever way its motor turns it: by the cosine of its elevation, of @ q + zero.
        sinks = -size * float(np.sign(ratios[joint]))
        rows.append((name, joint, row, -sinks * np.sin(zero), sinks * np.cos(zero)))
    names, joints, of, sin, cos = zip(*rows, strict=True)
    return JointErrors(names, np.array(joints), np.array(of), np.array(sin), np.array(cos))
