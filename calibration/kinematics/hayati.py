"""The same arm in another choice of link frames: without far frames, or in pure DH form.

A frame may slide along and turn about its own joint axis, if the next link takes it back: the arm is the
same for all joints. Universal Robots writes its factory calibration in pure DH form, where the common normal
of two almost parallel axes can lie hundreds of metres away; Hayati's form has it near.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.kinematics.chain import SerialChain
from cell.poses import Array

_PARALLEL = 1e-9  # rad; below it the common normal may lie anywhere
_TURN = 2.0 * np.pi


def with_near_frames(chain: SerialChain, links: Sequence[int], d: Sequence[float]) -> SerialChain:
    """The chain with ``d`` (m) of the given ``links`` as wanted, their ``beta`` taking up the rest.

    The link after each must turn or be rigid about the shifted axis. The last frame does not change.
    """
    for i, wanted in zip(links, d, strict=True):
        x, _, u, p = _frame(chain, i)
        if chain.sliding[i + 1] or abs(u[2]) < 0.5:
            raise ValueError(f"the axes before and after link {i + 1} are not near parallel")
        slide = (wanted - p[2]) / u[2]
        p = p + slide * u
        side = -1.0 if chain.a[i] < 0.0 else 1.0
        theta = _near(np.arctan2(side * p[1], side * p[0]), chain.theta[i])
        if np.hypot(p[0], p[1]) < 1e-12:
            theta = chain.theta[i]
        c, s = np.cos(theta), np.sin(theta)
        v = np.array([c * u[0] + s * u[1], -s * u[0] + c * u[1], u[2]])
        beta, alpha = np.arcsin(np.clip(v[0], -1.0, 1.0)), np.arctan2(-v[1], v[2])
        a = float(c * p[0] + s * p[1])
        chain = _moved(chain, i, (theta, wanted, a, alpha, beta), float(slide), x)
    return chain


def in_dh_form(chain: SerialChain) -> SerialChain:
    """The chain with ``beta`` zero everywhere, by common normals; ``d`` may become very large."""
    for i in np.flatnonzero(chain.beta):
        if i + 1 == len(chain.theta):
            raise ValueError("the last link has a beta, which pure DH cannot hold")
        if chain.sliding[i + 1]:
            raise ValueError(f"link {i + 2} slides: its axis has no place of its own")
        x, _, u, p = _frame(chain, int(i))
        across = np.array([-u[1], u[0], 0.0])  # z x u
        sine = float(np.linalg.norm(across))
        if sine < _PARALLEL:
            chain = with_near_frames(chain, [int(i)], [float(chain.d[i])])
            beta = chain.beta.copy()
            beta[i] = 0.0
            chain = replace(chain, beta=beta)
            continue
        axis = across / sine
        wanted = np.array([np.cos(chain.theta[i]), np.sin(chain.theta[i]), 0.0])
        if axis @ wanted < 0.0:
            axis = -axis
        # foot of the common normal on the next axis: its part along z x u is the normal's length
        slide = -(p[:2] @ u[:2]) / sine**2
        foot = p + slide * u
        theta = _near(np.arctan2(axis[1], axis[0]), chain.theta[i])
        alpha = np.arctan2(across @ axis, u[2])
        chain = _moved(chain, int(i), (theta, foot[2], float(foot @ axis), alpha, 0.0), float(slide), x)
    return chain


def _frame(chain: SerialChain, i: int) -> tuple[Array, Array, Array, Array]:
    """Axes and origin after link ``i`` in the frame before it, joints at zero."""
    one = SerialChain(
        theta=chain.theta[i : i + 1],
        d=chain.d[i : i + 1],
        a=chain.a[i : i + 1],
        alpha=chain.alpha[i : i + 1],
        beta=chain.beta[i : i + 1],
        sliding=chain.sliding[i : i + 1],
        coupling=np.zeros((1, 1)),
    )
    T = one.flange(np.zeros((1, 1)))[0]
    return T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3]


def _moved(
    chain: SerialChain, i: int, link: tuple[float, float, float, float, float], slide: float, x_before: Array
) -> SerialChain:
    """``chain`` with another ``link`` i whose frame slid along its axis; the next link makes up for it."""
    parts = [part.copy() for part in (chain.theta, chain.d, chain.a, chain.alpha, chain.beta)]
    for part, value in zip(parts, link, strict=True):
        part[i] = value
    moved = replace(chain, theta=parts[0], d=parts[1], a=parts[2], alpha=parts[3], beta=parts[4])
    x, y, _, _ = _frame(moved, i)
    turned = np.arctan2(x_before @ y, x_before @ x)  # of the old x axis, seen in the new frame
    theta, d = moved.theta.copy(), moved.d.copy()
    theta[i + 1] = _near(theta[i + 1] + turned, 0.0)
    d[i + 1] -= slide
    return replace(moved, theta=theta, d=d)


def _near(angle: float, wanted: float) -> float:
    """``angle`` by full turns closest to ``wanted``."""
    return float(angle - _TURN * np.round((angle - wanted) / _TURN))
