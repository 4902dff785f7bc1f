"""Insertions with half a millimetre free: collisions, parts that went in, and whether the prediction holds.

``python -m bench.slot [RUNS] [--uncalibrated N] [--first SEED]``: the job slot-insertion on virtual time in
the scenario slot. Each run draws its arm, what is left of the arm's errors after a calibration, the camera's
pose within its stated covariance, the part's place in the gripper and the place of the rack; the slot is
found in pictures. A row for each run: how far the part truly was beside the middle of the slot (at its end,
or at the plate that it met), and what was predicted to 95 % there. Then N runs each on arms that nobody
calibrated, of the usual size and three times as bad, with the hand-eye that a capture with that very arm
finds.
"""

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.adjustment.arm_terms import ArmPrior, reference_joints
from calibration.adjustment.gauge import apart, base_and_flange
from calibration.kinematics.families import arm_spec
from cell.formats.robot import parse_robot
from cell.poses import Array, exp_xi, from_pose6, to_pose6
from daemon.config import CellConfig, load_config
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from fakes.world.toml_text import to_toml
from tests.kit.object_cell import ObjectCell, on_disk, open_cell, write_config
from tests.kit.slot_cell import BUDGET, HAND_EYE_COV, SLOT, lens_of, rack_of

JOINTS = reference_joints(np.tile([-np.pi, np.pi], (6, 1)), power=8, seed=99)
LEFT = 0.13  # of an arm's errors after a calibration: about 0.1 mm RMS
PART_SIGMA = np.repeat([1e-4, 1e-3], 3)  # m, rad; as the job has it by default
WORSE = (1.0, 3.0)  # than the usual errors of an arm with the calibration of its factory
SLOTS = (1, 3, 4, 5, 6)  # a part is in the second
MODEL = {"name": "kinematics.arm", "version": 1}
HEAD = f"{'seed':>5}{'slot':>5}  {'part':<10}{'beside mm':>10}{'95 % mm':>9}{'inside':>8}{'arm left mm':>13}"


@dataclass(frozen=True)
class Run:
    """One insertion; lengths in m."""

    slot: int
    part: str
    collided: bool
    went_in: bool
    beside: float
    predicted: float
    arm_left: float
    reasons: tuple[str, ...]

    @property
    def inside(self) -> bool:
        return self.beside <= self.predicted

    def row(self, seed: int) -> str:
        return (
            f"{seed:5}{self.slot:5}  {self.part:<10}{1e3 * self.beside:10.3f}{1e3 * self.predicted:9.3f}"
            f"{'yes' if self.inside else 'NO':>8}{1e3 * self.arm_left:13.3f}"
            + ("  COLLIDED" if self.collided else "")
        )


@dataclass(frozen=True)
class Draw:
    """An arm's links (rad and m by UR's names), as they are and as a calibration has them, and the rest."""

    slot: int
    links: dict[str, Array]
    calibrated: dict[str, Array]
    hand_eye: Array
    part: Array
    rack: Array

    @classmethod
    def of(cls, seed: int, worse: float = 1.0) -> "Draw":
        rng, usual = np.random.default_rng([seed, 0x510]), ArmPrior()
        sizes = {
            "delta_theta": usual.angle,
            "delta_d": usual.length,
            "delta_a": usual.length,
            "delta_alpha": usual.angle,
        }
        links = {key: worse * size * rng.normal(size=6) for key, size in sizes.items()}
        left = {key: LEFT * size * rng.normal(size=6) for key, size in sizes.items()}
        return cls(
            SLOTS[seed % len(SLOTS)],
            links,
            {key: links[key] - left[key] for key in links},
            rng.multivariate_normal(np.zeros(6), HAND_EYE_COV),
            PART_SIGMA * rng.normal(size=6),
            np.repeat([0.002, 0.0015], 3) * rng.normal(size=6),
        )

    def flanges(self, links: dict[str, Array], Q: Array) -> Array:
        robot = {"model": "ur10e", "calibration": {key: v.tolist() for key, v in links.items()}}
        return arm_spec(parse_robot(robot, "robot")).arm.base.flange(Q)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", nargs="?", type=int, default=100)
    parser.add_argument("--uncalibrated", type=int, default=5, help="runs on arms that nobody calibrated")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print(HEAD)
    done = []
    for seed in range(options.first, options.first + options.runs):
        done.append(_in_folder(calibrated, seed))
        print(done[-1].row(seed), flush=True)
    if done:
        print(summary(done))
    cases = [(k, seed) for k in WORSE for seed in range(options.first, options.first + options.uncalibrated)]
    for worse, seed in cases:
        run = _in_folder(partial(uncalibrated, worse), seed)
        said = "; ".join(run.reasons) or "not refused"
        collided = ", collided" if run.collided else ""
        put = f", put {1e3 * run.beside:.3f} mm beside" if run.went_in or run.collided else ""
        print(
            f"arm {seed}, {1e3 * run.arm_left:.2f} mm off: part {run.part}{collided}, predicted "
            f"{1e3 * run.predicted:.3f} mm{put}; {said}",
            flush=True,
        )


def summary(runs: list[Run]) -> str:
    """What the runs came to."""
    n, beside = len(runs), np.array([run.beside for run in runs])
    predicted = np.array([run.predicted for run in runs])
    ends = ", ".join(f"{count} {part}" for part, count in Counter(run.part for run in runs).items())
    return "\n".join(
        [
            f"{n} insertions: {sum(r.collided for r in runs)} collisions, "
            f"{sum(r.went_in for r in runs)} inserted ({ends})",
            f"beside the middle: {1e3 * np.sqrt(np.mean(beside**2)):.3f} mm RMS, "
            f"worst {1e3 * beside.max():.3f} mm",
            f"predicted (95 %): {1e3 * predicted.min():.3f} to {1e3 * predicted.max():.3f} mm; it held in "
            f"{sum(r.inside for r in runs)} of {n}",
        ]
    )


def _in_folder(one: Any, seed: int) -> Run:
    with tempfile.TemporaryDirectory() as folder:
        found: Run = one(seed, Path(folder))
    return found


def calibrated(seed: int, folder: Path) -> Run:
    """On an arm whose kinematics and camera are calibrated, as well as it is stated."""
    draw = Draw.of(seed)
    true, model = draw.flanges(draw.links, JOINTS), draw.flanges(draw.calibrated, JOINTS)
    flange = base_and_flange(model, true)[1]
    left = float(np.sqrt(np.mean(np.sum(apart(model, true)[:, :3] ** 2, axis=1))))
    setting = _config(draw, seed, folder, flange, use_kinematics=True)

    async def play() -> Run:
        async with open_cell(setting, job=SLOT) as cell:
            _commit(cell, "kinematics.arm", _kinematics(draw, left), None)
            X = flange @ cell.plant.world.T_mount_camera.as_matrix()
            told = to_pose6(from_pose6(_six(X)) * exp_xi(draw.hand_eye))
            nominal = list(cell.config.robot.T_flange_camera_nominal or [])
            answer = {"T_flange_camera": told.tolist(), "cov": HAND_EYE_COV.tolist(), "budget": BUDGET}
            answer["lens"] = lens_of(cell.plant.world.intrinsics) | {"rms_px": 0.1}
            _commit(cell, "T_flange_camera", told.tolist(), nominal, {"result": answer}, MODEL)
            return await _insertion(cell, draw, left)

    return run_virtual(play())


def uncalibrated(worse: float, seed: int, folder: Path) -> Run:
    """On an arm as it comes, its errors ``worse`` times the usual, with a hand-eye captured with it."""
    draw = Draw.of(seed, worse)
    nominal = draw.flanges(dict.fromkeys(draw.links, np.zeros(6)), JOINTS)
    off = apart(nominal, draw.flanges(draw.links, JOINTS))
    left = float(np.sqrt(np.mean(np.sum(off[:, :3] ** 2, axis=1))))
    setting = _config(draw, seed, folder, np.eye(4), use_kinematics=False)

    async def play() -> Run:
        async with open_cell(setting) as cell:
            await cell.run_job()
            row = cell.ledger.results("T_flange_camera")[0]
            on_disk(cell.ledger.accept, row["id"], "bench")
            cell.job = SLOT
            return await _insertion(cell, draw, left)

    return run_virtual(play())


async def _insertion(cell: ObjectCell, draw: Draw, left: float) -> Run:
    number = await cell.start(job=SLOT, params={"slot": str(draw.slot)})
    end = await cell.finished(number)
    if end["outcome"] != "complete":
        raise RuntimeError(f"the job ended as {end}")
    result, rack = cell.result(number), rack_of(cell)
    answer, now = result["result"], cell.clock.now()
    budget = answer["budget"]
    collided = bool(rack.on_face)
    offset = rack.offset(0, draw.slot, rack.on_face[0] if collided else now).translation
    return Run(
        draw.slot,
        answer["part"],
        collided,
        answer["part"] == "released" and rack.in_slot(draw.slot, now) == 0,
        float(np.linalg.norm(offset[:2])),
        budget["at_mouth_m"] if collided else budget["at_end_m"],
        left,
        tuple(result["reasons"]),
    )


def _config(draw: Draw, seed: int, folder: Path, flange: Array, use_kinematics: bool) -> CellConfig:
    """``flange`` (4, 4): by what a pose on the flange stands elsewhere for the arm's model."""
    text = files("fakes").joinpath("scenarios", "slot.toml").read_text("utf-8")
    tables = Scenario.parse(text).model_dump(by_alias=True, exclude_none=True)
    world, job = tables["world"], tables["cell"]["job"][SLOT]
    world["seed"] = seed
    if use_kinematics:  # found by the calibration, too
        world["arm"].pop("joint_errors", None)
    world["arm"]["error"] = {key: v.tolist() for key, v in draw.links.items()}
    rack = from_pose6(job["rack"]["T_base_rack"]) * exp_xi(draw.rack)
    world["rack"]["T_base_rack"] = to_pose6(rack).tolist()
    q = np.array([tables["cell"]["poses"]["feed"]])
    nominal = from_pose6(world["tool"]["T_flange_tool"]) * from_pose6(job["part"]["T_tool_part"])
    held = from_pose6(_six(np.asarray(np.linalg.inv(flange)))) * nominal * exp_xi(draw.part)
    part = draw.flanges(draw.links, q)[0] @ held.as_matrix()
    world["rack"]["parts"][0] = {"T_base_part": _six(part)}
    scenario = folder / "slot.toml"
    scenario.write_text(to_toml(tables), "utf-8")
    look = {"look": {"frames": 1, "settle_s": 0.1}, "insertion": {"speed_m_s": 0.05}}
    capture = {"poses_per_placement": 20, "frames_per_pose": 5, "placements": 1}
    write_config(folder, str(scenario), capture, jobs={SLOT: look})
    toml = folder / "cell.toml"
    use = f"[robot]\nuse_kinematics = {str(use_kinematics).lower()}"
    toml.write_text(toml.read_text("utf-8").replace("[robot]", use, 1), "utf-8")
    return load_config(toml)


def _kinematics(draw: Draw, left: float) -> dict[str, Any]:
    calibration = {key: v.tolist() for key, v in draw.calibrated.items()}
    robot = {"model": "ur10e", "calibration": calibration}
    return {"schema": "cellward.kinematics/1", "robot": robot, "payload_kg": 1.2, "rms_calibrated": left}


def _commit(
    cell: ObjectCell,
    name: str,
    value: Any,
    configured: Any,
    result: dict[str, Any] | None = None,
    model: dict[str, Any] | None = None,
) -> None:
    entry = on_disk(cell.ledger.propose, name, value, result or {}, 0, configured, model)
    on_disk(cell.ledger.accept, entry, "bench")


def _six(T: Array) -> list[float]:

    return [float(v) for v in to_pose6(RigidTransform.from_matrix(T))]


if __name__ == "__main__":
    main()
