"""The four-axis palletizer with a parallelogram that keeps its flange level.

Standard DH with motor-side joints q = [q1, q2, q3, q5]; the fourth link turns back what the second and third
turned. At home q2 is 90 and q3 is -90 degrees.

| i | theta | d | a | alpha |
|---|---|---|---|---|
| 1 | k1 q1 + t1 | d1 | a1 | +90 |
| 2 | k2 q2 + t2 | 0 | a2 | 0 |
| 3 | k3 q3 + t3 | 0 | a3 | 0 |
| 4 | -(k2 q2 + t2) - (k3 q3 + t3) | 0 | a4 | -90 |
| 5 | k5 q5 + t5 | d5 | a5 | 0 |
"""

import numpy as np

from calibration.kinematics.chain import SerialChain
from calibration.kinematics.parametric import Kind, ParametricArm
from cell.formats.robot import PalletizerParameters

NAMES = ("a1", "a2", "a3", "a4", "a5", "d1", "d5", "k1", "k2", "k3", "k5", "t1", "t2", "t3", "t5")
_KINDS: dict[str, Kind] = {"a": "length", "d": "length", "k": "ratio", "t": "angle"}
_RATIOS = ((0, 0), (1, 1), (2, 2), (3, 1), (3, 2), (4, 3))  # entries of the coupling that are not zero
_LINKS = 5


def palletizer(parameters: PalletizerParameters) -> ParametricArm:
    """The arm with 15 parameters of its own; the place of the reflector makes 18."""
    p = parameters
    coupling = np.zeros((_LINKS, 4))
    for (row, column), k in zip(_RATIOS, (p.k1, p.k2, p.k3, -p.k2, -p.k3, p.k5), strict=True):
        coupling[row, column] = k
    chain = SerialChain(
        theta=np.array([p.t1, p.t2, p.t3, -p.t2 - p.t3, p.t5]),
        d=np.array([p.d1, 0.0, 0.0, 0.0, p.d5]),
        a=np.array([p.a1, p.a2, p.a3, p.a4, p.a5]),
        alpha=np.array([np.pi / 2, 0.0, 0.0, -np.pi / 2, 0.0]),
        beta=np.zeros(_LINKS),
        sliding=np.zeros(_LINKS, dtype=bool),
        coupling=coupling,
    )
    return ParametricArm(
        family="palletizer4",
        names=NAMES,
        kinds=tuple(_KINDS[name[0]] for name in NAMES),
        nominal=np.array([getattr(p, name) for name in NAMES]),
        base=chain,
        betas=np.zeros(0, dtype=np.int64),
        ratios=np.array(_RATIOS, dtype=np.int64),
        mix=_mix(),
    )


def _mix() -> np.ndarray:
    """(15, 26): what each parameter moves: theta, d, a, alpha of five links, then the coupling's entries."""
    mix = np.zeros((len(NAMES), 4 * _LINKS + len(_RATIOS)))
    theta, d, a, ratio = 0, _LINKS, 2 * _LINKS, 4 * _LINKS
    moves = {
        **{f"a{i}": {a + i - 1: 1.0} for i in range(1, 6)},
        "d1": {d: 1.0},
        "d5": {d + 4: 1.0},
        "k1": {ratio: 1.0},
        "k2": {ratio + 1: 1.0, ratio + 3: -1.0},
        "k3": {ratio + 2: 1.0, ratio + 4: -1.0},
        "k5": {ratio + 5: 1.0},
        "t1": {theta: 1.0},
        "t2": {theta + 1: 1.0, theta + 3: -1.0},
        "t3": {theta + 2: 1.0, theta + 3: -1.0},
        "t5": {theta + 4: 1.0},
    }
    for row, name in enumerate(NAMES):
        for column, factor in moves[name].items():
            mix[row, column] = factor
    return mix
