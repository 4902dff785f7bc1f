"""Factory kinematics: how this arm's links differ from its nominal model."""

from typing import Any

from drivers.ur.primary import Kinematics, Six

_HALF_TURN = 3.141592653589793 / 2
_TWISTS: Six = (_HALF_TURN, 0.0, 0.0, _HALF_TURN, -_HALF_TURN, 0.0)

# d1, a2, a3, d4, d5, d6 in metres, from Universal Robots' page of DH parameters.
_NOMINAL = {
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur7e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur8long": (0.2186, -0.8989, -0.7149, 0.1824, 0.1361, 0.1434),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur12e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur15": (0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "ur18": (0.2186, -0.475, -0.3389, 0.1824, 0.1361, 0.1434),
    "ur20": (0.2363, -0.8620, -0.7287, 0.2010, 0.1593, 0.1543),
    "ur30": (0.2363, -0.6370, -0.5037, 0.2010, 0.1593, 0.1543),
}


def describe(model: str, found: Kinematics) -> dict[str, Any]:
    """For ``Identity.extra``: check sums, the arm's own DH rows and, for known models, the deltas.

    ``calibration`` has the keys of a ROBOT data set (``delta_theta`` rad, ``delta_d`` m, ``delta_a`` m,
    ``delta_alpha`` rad), so it can be used as one.
    """
    info: dict[str, Any] = {
        "checksum": list(found.checksum),
        "status": found.status,
        "theta": list(found.theta),
        "d": list(found.d),
        "a": list(found.a),
        "alpha": list(found.alpha),
    }
    nominal = _NOMINAL.get(model)
    if nominal is not None:
        d1, a2, a3, d4, d5, d6 = nominal
        info["calibration"] = {
            "delta_theta": list(found.theta),
            "delta_d": _less(found.d, (d1, 0.0, 0.0, d4, d5, d6)),
            "delta_a": _less(found.a, (0.0, a2, a3, 0.0, 0.0, 0.0)),
            "delta_alpha": _less(found.alpha, _TWISTS),
        }
    return info


def _less(found: Six, nominal: Six) -> list[float]:
    return [f - n for f, n in zip(found, nominal, strict=True)]
