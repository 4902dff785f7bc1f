"""How noisy the corners and the arm are: given, or found from the same data by REML.

The covariance of a residual is a sum of parts, ``V_i = sum_k s_k^2 S_ki``: corner noise through the pose of
the target, the flange's position and its attitude. Restricted maximum likelihood estimates the s_k without
the bias that comes from having fitted X and W to the same residuals.
Source: Patterson and Thompson 1971; scoring as in Searle, Casella and McCulloch, Variance Components, ch. 6.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.hand_eye.normal import Linearised, normal, row_blocks
from calibration.hand_eye.problem import flange_adjoint
from cell.poses import Array, adjoint

PARTS = ("sigma_px", "sigma_flange_t", "sigma_flange_r", "sigma_pose_t", "sigma_pose_r")
_START = {"sigma_px": 0.3, "sigma_flange_t": 2e-4, "sigma_flange_r": 2e-4}
_START_POSE = {"sigma_pose_t": 1e-3, "sigma_pose_r": 1e-3}
_FLOOR = {"sigma_px": 1e-3, "sigma_flange_t": 1e-7, "sigma_flange_r": 1e-7}
_SMALLEST = 1e-7
# A factory-calibrated arm is good to about 1 mm at 1 m of reach; what is beyond that is doubted.
MOST = {"sigma_flange_r": 1e-3}


@dataclass(frozen=True)
class Noise:
    """Standard deviations by name: pixels, metres, radians. ``estimated`` names those not given, of which
    those in ``most`` do not get larger than that."""

    sigma: Mapping[str, float]
    estimated: tuple[str, ...] = ()
    most: Mapping[str, float] = field(default_factory=MOST.copy)

    @property
    def implausible(self) -> tuple[str, ...]:
        """Estimated levels that are, or would be without a limit, beyond what an arm in working order has."""
        return tuple(k for k in self.estimated if self.sigma[k] >= 0.999 * MOST.get(k, np.inf))

    def as_dict(self) -> dict[str, object]:
        """For the result."""
        return {**{k: float(v) for k, v in self.sigma.items()}, "estimated": list(self.estimated)}


def first_noise(
    lin: Linearised, given: Mapping[str, float], most: Mapping[str, float] | None = None
) -> Noise:
    """Levels to start from: those given, the corners' from their own residuals, a guess for the rest; with
    the limits ``most``, ``MOST`` unless given.

    Flange noise and the noise of bare poses cannot be told apart: without corners the flange's enters only
    when it is given.
    """
    problem = lin.problem
    bare = ~np.any(problem.cov_px, axis=(1, 2))
    names = [k for k in PARTS[:3] if k in given or not bare.all()]
    if bare.all() and "sigma_px" in names:
        names.remove("sigma_px")
    names += [k for k in PARTS[3:] if bare.any()]
    sigma = {}
    for name in names:
        level = given.get(name, (_START | _START_POSE)[name])
        sigma[name] = max(level, _FLOOR.get(name, _SMALLEST))  # no noise at all would leave nothing to weigh
    if "sigma_px" in names and "sigma_px" not in given:
        rows = (problem.dof > 0) & ~bare
        if rows.any():
            level = np.sqrt(float(np.median(problem.sse[rows] / problem.dof[rows])))
            sigma["sigma_px"] = max(level, _FLOOR["sigma_px"])
    limits = MOST if most is None else most
    return Noise(sigma, tuple(k for k in names if k not in given), dict(limits))


def shapes(lin: Linearised, names: tuple[str, ...]) -> Array:
    """S_ki (k, n, 6, 6): covariance of each residual for a unit of each kind of noise, camera frame."""
    problem = lin.problem
    bare = ~np.any(problem.cov_px, axis=(1, 2))
    out = np.zeros((len(names), problem.n, 6, 6))
    flange = flange_adjoint(problem, lin.at, lin.predicted) if any("flange" in k for k in names) else None
    target = adjoint(lin.predicted) * bare[:, None, None] if bare.any() else None
    for k, name in enumerate(names):
        if name == "sigma_px":
            out[k] = problem.cov_px
            continue
        carrier = flange if "flange" in name else target
        if carrier is None:
            continue
        if problem.n and carrier.strides[0] == 0:
            carrier = carrier[:1]  # of a camera on the flange that of every pose is the same
        part = carrier[..., :3] if name.endswith("_t") else carrier[..., 3:]
        out[k] = part @ np.swapaxes(part, 1, 2)
    return out


def variances(noise: Noise, parts: Array) -> Array:
    """V (n, 6, 6) from :func:`shapes` of the same names."""
    square = np.array([v**2 for v in noise.sigma.values()])
    return np.tensordot(square, parts, axes=1)


def perfect_arm_variances(lin: Linearised, noise: Noise) -> Array:
    """V (n, 6, 6) that a perfect arm would leave: of corners and bare poses alone.

    NaN where the noise of bare poses was estimated and nothing told that of the flange: it holds both.
    """
    measured = {k: v for k, v in noise.sigma.items() if "flange" not in k}
    V = variances(replace(noise, sigma=measured), shapes(lin, tuple(measured)))
    flange = {k.replace("flange", "pose") for k in noise.sigma if "flange" in k}
    mixed = set(PARTS[3:]) & set(noise.estimated) - flange
    return np.full_like(V, np.nan) if mixed else V


def weights(lin: Linearised, noise: Noise) -> Array:
    """V^-1 (n, 6, 6) of all residuals at ``lin``."""
    return inverse_spd(variances(noise, shapes(lin, tuple(noise.sigma))))


def inverse_spd(V: Array) -> Array:
    """Inverses of symmetric matrices (n, k, k) that mix metres and radians."""
    s = 1.0 / np.sqrt(np.einsum("nii->ni", V))
    scale = s[:, :, None] * s[:, None, :]
    scaled = V * scale
    scaled += 1e-13 * np.eye(V.shape[1])
    out: Array = np.linalg.inv(scaled)
    out *= scale
    return out


def reml(lin: Linearised, noise: Noise, iterations: int = 40) -> Noise:
    """The estimated levels at their restricted maximum, starting from those of ``noise``.

    ``lin`` must be near the solution: the problem is taken as linear around it. The residuals of the corners
    inside each image enter the likelihood too.
    """
    if not noise.estimated:
        return noise
    names = tuple(noise.sigma)
    parts = shapes(lin, names)
    free = np.array([k in noise.estimated for k in names])
    theta = np.log(np.array([noise.sigma[k] ** 2 for k in names]))
    floor = np.log(np.array([_FLOOR.get(k, _SMALLEST) ** 2 for k in names]))
    ceiling = np.log(np.array([noise.most.get(k, np.inf) ** 2 for k in names]))
    for _ in range(iterations):
        score, info = _score(lin, parts, np.exp(theta), names)
        active = free & ~((theta <= floor + 1e-9) & (score < 0.0))
        active &= ~((theta >= ceiling - 1e-9) & (score > 0.0))
        if not active.any():
            break
        block = info[np.ix_(active, active)]
        ridge = 1e-6 * np.eye(len(block)) * (1e-3 + np.trace(block))
        step = np.zeros(len(names))
        step[active] = np.clip(np.linalg.solve(block + ridge, score[active]), -1.5, 1.5)
        theta = np.clip(theta + step, floor, ceiling)
        if abs(float(step @ score)) < 1e-3:
            break
    sigma = dict(zip(names, np.exp(0.5 * theta), strict=True))
    return replace(noise, sigma={k: float(v) for k, v in sigma.items()})


def scores_of_noise(V: Array, R: Array, Pr: Array) -> tuple[Array, Array]:
    """Score (k,) and metric (k, k) of the k noise levels that have the parts ``V`` (k, n, d, d) in the
    variance of n observations, by their weighted residuals ``Pr`` (n, d, 1); ``R`` (n, d, d) is the weight
    less what the fit follows of each."""
    RV = R @ V
    score = 0.5 * (np.sum(Pr * (V @ Pr), axis=(1, 2, 3)) - np.einsum("knii->k", RV))
    flat = RV.reshape(len(V), -1)
    return score, 0.5 * (flat @ np.swapaxes(RV, 2, 3).reshape(len(V), -1).T)


def _score(lin: Linearised, parts: Array, square: Array, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Derivative of the restricted log-likelihood by the logarithms of the variances, and its metric.

    The metric leaves out the coupling of different observations through X and W: it steers the steps, the
    zero of the score is exact.
    """
    problem = lin.problem
    P = inverse_spd(np.tensordot(square, parts, axes=1))
    equations = normal(lin, P)
    delta = -equations.solve()
    every = equations.covariance().own
    k = len(names)
    score, info = np.zeros(k), np.zeros((k, k))
    for rows in row_blocks(problem.n):
        J, W, group = lin.J[rows], P[rows], problem.group[rows]
        mine = np.concatenate([np.broadcast_to(delta[0], (len(J), 6)), delta[1:][group]], axis=1)
        Pr = W @ (lin.r[rows, :, None] + J @ mine[..., None])
        PJ = W @ J
        R = W - PJ @ every[group] @ np.swapaxes(PJ, 1, 2)
        V = parts[:, rows] * square[:, None, None, None]
        of_score, of_info = scores_of_noise(V, R, Pr)
        score += of_score
        info += of_info
    if "sigma_px" in names:
        i = names.index("sigma_px")
        dof = float(problem.dof.sum())
        score[i] += 0.5 * (float(problem.sse.sum()) / square[i] - dof)
        info[i, i] += 0.5 * dof
    return score, info
