"""The whole chain in cells as one finds them: cone capture, uncertainty, and the arm before and after.

``python -m bench.workshop [RUNS] [--poses N] [--frames N] [--first SEED] [--images] [--into FILE]``: the job
cone-capture on virtual time in the scenario workshop, each run with an arm (links, gears, sag), a lens, a
print and noise of its own draw. The configuration says nothing of them: priors are the defaults. A row for
each run: the error of the camera's pose, its standard uncertainty, and the squared Mahalanobis distance (6 is
expected); then the position error of the arm over all its joints, none of them measured, as it is and as
stated, before and after the correction. Coverage over all runs comes last. With ``--images`` every frame that
is captured is drawn and searched for corners; without, corners are computed and have noise. With ``--into``
each run is added to a file as a line of JSON when it is done; runs that the file holds already are not played
again.
"""

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.stats import chi2

from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.gauge import apart
from calibration.kinematics.families import arm_spec
from cell.formats.robot import parse_robot
from cell.poses import Array, from_pose6, log_xi
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from fakes.world.toml_text import to_toml
from procedures.twin_arm import true_flange
from tests.kit.object_cell import open_cell, write_config

JOINTS = reference_joints(np.tile([-np.pi, np.pi], (6, 1)), seed=1234)
LENGTH_M, ANGLE_RAD = 6e-5, 9e-5  # standard deviations of the links' errors
CAMERAS = {False: "fakes.object:ObjectCamera", True: "tests.kit.drawn_camera:DrawnCamera"}
INSIDE = ("inside_t", "inside_r", "below")
HEAD = (
    f"{'seed':>5}{'verdict':>9}   {'camera mm':>10}{'stated':>8}{'m2':>7}   "
    f"{'arm before mm':>14}{'stated':>8}   {'after':>7}{'stated':>8}{'95 % below':>12}{'share':>7}"
)


@dataclass(frozen=True)
class Run:
    """One run: the camera's pose, its squared distance and its error; then RMS position errors of the arm.

    All lengths in m; of the corrected arm's errors the share ``below`` is below ``stated95``.
    """

    verdict: str
    m2: float
    inside_t: bool
    inside_r: bool
    off: float
    stated: float
    before: float
    before_stated: float
    after: float
    after_stated: float
    stated95: float
    below: float

    def row(self, seed: int) -> str:
        lengths = [self.off, self.stated, self.before, self.before_stated, self.after, self.after_stated]
        off, stated, before, before_stated, after, after_stated = (1e3 * v for v in lengths)
        return (
            f"{seed:5}{self.verdict:>9}   {off:10.3f}{stated:8.3f}{self.m2:7.1f}   "
            f"{before:14.3f}{before_stated:8.3f}   {after:7.3f}{after_stated:8.3f}"
            f"{1e3 * self.stated95:12.3f}{100 * self.below:6.0f}%"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", nargs="?", type=int, default=30)
    parser.add_argument("--poses", type=int, default=12, help="of each of the three placements")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--images", action="store_true", help="draw pictures and find the corners in them")
    parser.add_argument("--frames", type=int, default=5, help="of each pose")
    parser.add_argument("--into", type=Path, help="file that keeps the runs, a line of JSON each")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    job = {"poses_per_placement": options.poses, "frames_per_pose": options.frames}
    settings = job | {"images": options.images}
    kept = {} if options.into is None else kept_runs(options.into, settings)
    print(HEAD)
    done = []
    for seed in range(options.first, options.first + options.runs):
        run = kept.get(seed)
        if run is None:
            with tempfile.TemporaryDirectory() as folder:
                run = one(seed, CAMERAS[options.images], job, Path(folder))
            if options.into is not None:
                keep(options.into, seed, settings, run)
        done.append(run)
        print(run.row(seed), flush=True)
    print(summary(done))


def kept_runs(path: Path, settings: dict[str, Any]) -> dict[int, Run]:
    """The runs in a file by seed; those that were played with other settings are passed over."""
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    rows = [json.loads(line) for line in lines]
    return {row["seed"]: Run(**row["run"]) for row in rows if row["settings"] == settings}


def keep(path: Path, seed: int, settings: dict[str, Any], run: Run) -> None:
    """One more line of the file."""
    row = {"seed": seed, "settings": settings, "run": asdict(run)}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def summary(runs: list[Run]) -> str:
    """Coverage in words and numbers."""

    def rms(key: str) -> float:
        return 1e3 * float(np.sqrt(np.mean([getattr(run, key) ** 2 for run in runs])))

    t, r, below = (100 * np.mean([getattr(run, key) for run in runs]) for key in INSIDE)
    nees = np.mean([run.m2 for run in runs])
    before, after = (rms(f"{key}_stated") / rms(key) for key in ("before", "after"))
    return "\n".join(
        [
            f"{len(runs)} runs",
            f"camera: {rms('off'):.3f} mm RMS, stated {rms('stated'):.3f}; mean m2 {nees:.1f}",
            f"inside the stated 95 %: place {t:.0f} %, rotation {r:.0f} %",
            f"arm before: {rms('before'):.3f} mm RMS, stated {rms('before_stated'):.3f}, ratio {before:.2f}",
            f"arm after: {rms('after'):.3f} mm RMS, stated {rms('after_stated'):.3f}, ratio {after:.2f}",
            f"below the stated 95 %: {below:.0f} % of the corrected arm's positions",
        ]
    )


def one(seed: int, camera: str, job: dict[str, Any], folder: Path) -> Run:
    """One capture in a cell of its own, solved, and judged."""
    scenario = folder / "workshop.toml"
    scenario.write_text(to_toml(drawn(seed)), "utf-8")
    job = {"placements": 3, "settle_s": 0.3, **job}
    config = write_config(folder, str(scenario), job, camera=camera)

    async def play() -> tuple[dict[str, Any], dict[str, Any]]:
        async with open_cell(config) as cell:
            end = await cell.run_job()
            if end["outcome"] != "complete":
                raise RuntimeError(f"seed {seed}: {end}")
            return cell.result(1), cell.plant.world.truth()

    result, truth = run_virtual(play())
    return judged(result, truth)


def judged(result: dict[str, Any], truth: dict[str, Any]) -> Run:
    """A result beside the truth of its twin."""
    answer = result["result"]
    cov = np.array(answer["cov"])
    found, true = (from_pose6(np.array(of["T_flange_camera"])) for of in (answer, truth))
    xi = log_xi(found.inv() * true)
    limit = chi2.ppf(0.95, 3)
    flange = true_flange(truth["robot"], JOINTS)
    before, after = (_off(robot, flange) for robot in ({"model": truth["robot"]["model"]}, answer["robot"]))
    stated = answer["arm"]
    return Run(
        str(result["verdict"]),
        float(xi @ np.linalg.solve(cov, xi)),
        bool(xi[:3] @ np.linalg.solve(cov[:3, :3], xi[:3]) < limit),
        bool(xi[3:] @ np.linalg.solve(cov[3:, 3:], xi[3:]) < limit),
        float(np.linalg.norm(xi[:3])),
        float(np.sqrt(np.trace(cov[:3, :3]))),
        _rms(before),
        stated["configured"]["t"],
        _rms(after),
        stated["corrected"]["t"],
        stated["corrected"]["t95"],
        float(np.mean(after < stated["corrected"]["t95"])),
    )


def _off(robot: dict[str, Any], flange: Array) -> Array:
    """(n,) m of a ROBOT's flange from the true one, after the best base and flange."""
    arm = arm_spec(parse_robot(robot, "robot")).arm.base
    return np.asarray(np.linalg.norm(apart(arm.flange(JOINTS), flange)[:, :3], axis=1))


def _rms(e: Array) -> float:
    return float(np.sqrt(np.mean(e**2)))


def drawn(seed: int) -> dict[str, Any]:
    """The scenario workshop with errors of another draw, of the sizes that the scenario gives sources for."""
    rng = np.random.default_rng([seed, 0x5A0])
    tables = Scenario.load("workshop").model_dump(by_alias=True, exclude_none=True)
    world = tables["world"]
    world["seed"] = seed
    sizes = {"delta_theta": ANGLE_RAD, "delta_d": LENGTH_M, "delta_a": LENGTH_M, "delta_alpha": ANGLE_RAD}
    world["arm"]["error"] = {key: (size * rng.normal(size=6)).tolist() for key, size in sizes.items()}
    world["arm"]["joint_errors"] = {
        "gear_once_rad": 2e-5 * float(rng.uniform(0.3, 2.0)),
        "gear_twice_rad": 2e-5 * float(rng.uniform(0.3, 2.0)),
        "sag_rad": (1e-4 * rng.uniform(0.3, 2.0, 3)).tolist(),
    }
    world["camera"]["told"] = {
        "focal": float(rng.uniform(-3e-3, 3e-3)),
        "centre_px": rng.normal(0.0, 2.0, 2).tolist(),
    }
    world["target_print"] = {
        "scale_x": float(rng.normal(0.0, 5e-4)),
        "scale_y": float(rng.normal(0.0, 5e-4)),
        "bow_m": float(rng.uniform(-2e-4, 2e-4)),
        "bow_rad": float(rng.uniform(-np.pi / 2, np.pi / 2)),
    }
    return tables


if __name__ == "__main__":
    main()
