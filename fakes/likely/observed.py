"""An arm that its own program moves: what its drawing leaves of links, gears, zeros and weight."""

from typing import Any

import numpy as np

from cell.known_cell import KnownObserved

# Standard deviations of what such an arm's controller, which was never calibrated, does not know. Their sizes
# are not published and differ: assumptions, those of the scenario palletizer, whose arm is 3 to 4 mm off.
LINK_M, RATIO, ZERO_RAD = 0.0008, 0.0003, 0.0008
LENGTHS, RATIOS, ZEROS = ("a1", "a2", "a3", "a4", "a5", "d1", "d5"), ("k1", "k2", "k3", "k5"), "t1 t2 t3 t5"
# Of gears and weight, assumptions too: gears as of the other arms, and twice the sag under its heavier load.
GEAR_RAD, SAG_RAD = 0.00002, 0.0002
# Data sheets of palletizers have 0.05 mm (ABB IRB 660) by ISO 9283, which is 3.6 standard deviations of an
# axis.
REPEATABILITY_M = 0.00005 / 3.6
# From a request until the arm sets out: a program that looks at its registers, and a person who types joints
# in at the pendant. Assumptions.
PROGRAM_S, PERSON_S = 1.0, 20.0
LIMIT_RAD = 6.28  # no configuration tells the limits of such an arm's program, so the twin's has none
SERIAL = "99995500001"


def draw_observed(known: KnownObserved, rng: np.random.Generator) -> dict[str, Any]:
    """``observed`` of a scenario's world; ``ValueError`` for an arm that is no palletizer of four joints."""
    if known.robot.get("family") != "palletizer4":
        text = f"the observed arm is of family {known.robot.get('family', 'serial6')!r}, and a twin of an arm"
        raise ValueError(f"{text} that is only read is a palletizer4")
    sizes = {
        **dict.fromkeys(LENGTHS, LINK_M),
        **dict.fromkeys(RATIOS, RATIO),
        **dict.fromkeys(ZEROS.split(), ZERO_RAD),
    }
    return {
        "serial": SERIAL,
        "q_start": np.mean(known.ranges, axis=1).tolist(),
        "limits": [[-LIMIT_RAD, LIMIT_RAD]] * len(known.ranges),
        "parameters": dict(known.robot["parameters"]),
        "error": {name: size * float(rng.standard_normal()) for name, size in sizes.items()},
        "joint_errors": {
            "gear_once_rad": GEAR_RAD,
            "gear_twice_rad": GEAR_RAD,
            "sag_rad": (SAG_RAD * rng.uniform(0.5, 1.5, 3)).tolist(),
        },
        "repeatability_t_m": REPEATABILITY_M,
        "reaction_s": PERSON_S if known.by_person else PROGRAM_S,
    }
