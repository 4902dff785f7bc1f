"""Closed-form inverse kinematics of the published UR arms: every branch of a pose.

The decomposition is the usual one (Hawkins, "Analytic Inverse Kinematics for the Universal Robots UR-5/UR-10
Arms", 2013). Axes 2, 3 and 4 are parallel: they move the wrist in a plane at the distance ``d4`` from axis 1.
That distance gives joint 1, the tool's orientation against the plane joints 5 and 6, and a planar arm of two
links the rest. Joint 5 comes from an arc tangent: an arc cosine loses half the digits where the wrist is
almost straight.
"""

from collections.abc import Iterator
from math import acos, atan2, cos, hypot, pi, sin

import numpy as np

from calibration.kinematics.inverse import TOLERANCE
from calibration.kinematics.ur_models import UrModel
from cell.poses import Array

# Of a cosine. A calibrated arm reaches some millimetres where the published one does not: its refinement
# starts from the published arm at full stretch.
_OVERREACH = 1e-2
_ON_AXIS_M = 1e-9  # a wrist this close to axis 1 has no azimuth


def branches(model: UrModel, T_base_flange: Array) -> Array:
    """(k, 6) joints in rad for the pose (4, 4), k from 0 to 8; each angle is one of its turns.

    Where axes 4 and 6 are parallel, joint 6 is free: one that lets the arm reach is taken. A branch that is
    just out of reach is the arm at full stretch and misses the pose by a few millimetres.
    """
    return np.array(list(_branches(model, T_base_flange)), dtype=float).reshape(-1, 6)


def _branches(model: UrModel, T: Array) -> Iterator[tuple[float, ...]]:
    (xx, yx, zx, px), (xy, yy, zy, py), (xz, yz, zz, pz) = T[:3].tolist()
    wrist_x, wrist_y, wrist_up = px - model.d6 * zx, py - model.d6 * zy, pz - model.d6 * zz - model.d1
    radius = hypot(wrist_x, wrist_y)
    for shoulder in _plus_minus(_arc_cosine(model.d4, radius if radius > _ON_AXIS_M else 0.0)):
        q1 = atan2(wrist_y, wrist_x) + shoulder + pi / 2
        c1, s1 = cos(q1), sin(q1)
        # Along the plane's normal, and outwards in the plane.
        x_normal, y_normal, z_normal = s1 * xx - c1 * xy, s1 * yx - c1 * yy, s1 * zx - c1 * zy
        x_out, y_out, z_out = c1 * xx + s1 * xy, c1 * yx + s1 * yy, c1 * zx + s1 * zy
        wrist_out = c1 * wrist_x + s1 * wrist_y
        bend = hypot(x_normal, y_normal)
        if bend > TOLERANCE:
            wrists = [(sign, [atan2(-sign * y_normal, sign * x_normal)]) for sign in (1.0, -1.0)]
        else:
            # Joint 4 stands on a circle about the wrist, smaller than the planar arm's range: when any of its
            # points can be reached, its nearest or its farthest point can.
            away = atan2(x_out * wrist_out + xz * wrist_up, y_out * wrist_out + yz * wrist_up)
            wrists = [(1.0, [away, away + pi / 2, away + pi])]
        for sign, choices in wrists:
            q5 = atan2(sign * bend, z_normal)
            c5, s5 = cos(q5), sin(q5)
            ends = []
            for q6 in choices:
                c6, s6 = cos(q6), sin(q6)
                out = wrist_out + model.d5 * (x_out * s6 + y_out * c6)
                up = wrist_up + model.d5 * (xz * s6 + yz * c6)
                ends.append((abs(_elbow_product(model, out, up)), q6, out, up))
            _, q6, out, up = min(ends)  # the elbow nearest to a right angle
            c6, s6 = cos(q6), sin(q6)
            turned = atan2(c5 * (xz * c6 - yz * s6) - s5 * zz, c5 * (x_out * c6 - y_out * s6) - s5 * z_out)
            for q2, q3 in _planar(model, out, up):
                yield q1, q2, q3, turned - q2 - q3, q5, q6


def _planar(model: UrModel, out: float, up: float) -> list[tuple[float, float]]:
    """Joints 2 and 3 that bring joint 4 to a point of the plane, elbow on either side."""
    a2, a3 = model.a2, model.a3
    elbows = _plus_minus(_arc_cosine(_elbow_product(model, out, up), a2 * a3))
    return [(atan2(up, out) - atan2(a3 * sin(q3), a2 + a3 * cos(q3)), q3) for q3 in elbows]


def _elbow_product(model: UrModel, out: float, up: float) -> float:
    """The scalar product of upper arm and forearm that ends at a point of the plane (law of cosines), m^2."""
    return (out * out + up * up - model.a2 * model.a2 - model.a3 * model.a3) / 2.0


def _arc_cosine(adjacent: float, hypotenuse: float) -> float | None:
    """None when no angle has this cosine; slightly beyond, the angle that comes closest."""
    if abs(adjacent) > (1.0 + _OVERREACH) * abs(hypotenuse):
        return None
    return acos(min(1.0, max(-1.0, adjacent / hypotenuse)))


def _plus_minus(angle: float | None) -> tuple[float, ...]:
    return () if angle is None else (angle, -angle)
