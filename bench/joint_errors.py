"""Gears and sag in a kinematic calibration: predictions beside the truth, with and without them as unknowns.

``python -m bench.joint_errors [COUNT]``: so many simulated UR10e a row. RMS error of predictions at 200 poses
that were not measured, how many are inside the stated 95 %, and the error over the Cramer-Rao bound of the
true model. The noise is not given. The classic method is beside them.
"""

import sys
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from bench._expected import expect
from bench.kincal import ERRORS, SIGMA0, SIGMA_PER_M, UR10E, VALIDATION
from calibration.identification.classic import solve_classic
from calibration.identification.estimator import Problem, normal_matrix
from calibration.identification.joint_errors import extended
from calibration.identification.solution import base_covariance, identify
from cell.poses import Array

POSES = (50, 200, 500)
MRAD = ((0.0, 0.0), (0.02, 0.1), (0.05, 0.3))  # gears and sag
COUNT = 30


@dataclass
class Row:
    """Squared errors (m^2) of each method, what was inside, and the bound."""

    classic: list[float] = field(default_factory=list)
    geometry: list[float] = field(default_factory=list)
    full: list[float] = field(default_factory=list)
    bound: list[float] = field(default_factory=list)
    inside_geometry: list[float] = field(default_factory=list)
    inside: list[float] = field(default_factory=list)

    def text(self) -> str:
        rms = {
            k: 1e6 * float(np.sqrt(np.mean(getattr(self, k))))
            for k in ("classic", "geometry", "full", "bound")
        }
        inside = [100.0 * float(np.mean(v)) for v in (self.inside_geometry, self.inside)]
        return (
            f"{rms['classic']:12.1f} {rms['geometry']:12.1f} {inside[0]:7.0f} % {rms['full']:12.1f} "
            f"{inside[1]:7.0f} % {rms['full'] / rms['bound']:10.2f}"
        )


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else COUNT
    print(f"{count} simulated UR10e a row; errors of predictions in um, RMS")
    names = ("classic", "geometry", "inside", "with both", "inside", "x bound")
    print(" ".join(f"{n:>{w}}" for n, w in zip(names, (28, 12, 9, 12, 9, 10), strict=True)))
    for poses in POSES:
        for gear, sag in MRAD:
            row = Row()
            for seed in range(count):
                _one(np.random.default_rng([seed, poses]), poses, 1e-3 * gear, 1e-3 * sag, row)
            print(f"{poses:6d} {f'{gear:g} / {sag:g}':>14} {row.text()}", flush=True)


def _one(rng: np.random.Generator, poses: int, gear: float, sag: float, row: Row) -> None:
    plain = UR10E.model
    model = extended(plain, {"gear": gear, "sag": sag} if gear else {"gear": 1e-12, "sag": 1e-12})
    sd = np.array([ERRORS[kind] for kind in model.kinds])
    sd[~model.geometric] = model.sd[~model.geometric]
    x = model.nominal + sd * rng.normal(size=model.size)
    Q, elsewhere = (rng.uniform(UR10E.low, UR10E.high, (n, 6)) for n in (poses, VALIDATION))
    T = RigidTransform.from_components([2.5, 1.5, 1.0], Rotation.from_rotvec(rng.normal(size=3))).inv()
    one, other = np.zeros(poses, dtype=np.int64), np.zeros(VALIDATION, dtype=np.int64)
    p, truth = T.apply(model.points(x, Q, one).T), T.apply(model.points(x, elsewhere, other).T)
    sigma = SIGMA0 + SIGMA_PER_M * np.linalg.norm(p, axis=1)
    problem = Problem(plain, Q, (p + sigma[:, None] * rng.normal(size=p.shape)).T.copy(), one)
    classic = solve_classic(problem)
    at = classic.registration.to_tracker(plain.points(classic.x, elsewhere, other)).T
    row.classic.append(float(np.mean(np.sum((at - truth) ** 2, axis=1))))
    for errors, inside, joint_errors in (
        (row.geometry, row.inside_geometry, False),
        (row.full, row.inside, True),
    ):
        at, cov = identify(problem, {}, joint_errors).predict(elsewhere)
        away = at - truth
        errors.append(float(np.mean(np.sum(away**2, axis=1))))
        squared = np.einsum("ni,nij,nj->n", away, np.linalg.inv(expect(np.ndarray, cov)), away)
        inside.append(float(np.mean(squared < chi2.ppf(0.95, 3))))
    if gear:
        row.bound.append(_bound(replace(problem, model=model), x, sigma, elsewhere))
    else:
        row.bound.append(_bound(problem, x[model.geometric], sigma, elsewhere))


def _bound(problem: Problem, x: Array, sigma: Array, elsewhere: Array) -> float:
    """Mean squared error (m^2) at joints ``elsewhere`` that no unbiased estimator is below."""
    model = problem.model
    _, J = model.linearised(x, problem.Q, problem.target)
    H = normal_matrix(J, sigma**-2.0)
    own = np.arange(model.size)
    H[own, own] += model.sd**-2.0
    scale = 1.0 / np.sqrt(np.diag(H))
    C = np.linalg.inv(H * np.outer(scale, scale)) * np.outer(scale, scale)
    _, J = model.linearised(x, elsewhere, np.zeros(len(elsewhere), dtype=np.int64))
    return float(np.mean(np.trace(base_covariance(C, J), axis1=1, axis2=2)))


if __name__ == "__main__":
    main()
