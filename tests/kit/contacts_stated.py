"""Contacts of picking beside what is stated of each, where calibrations are as wrong as they say."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.hand_eye import se3
from cell.calibrations import belt_scale, time_offset
from cell.poses import Array, from_pose6, to_pose6
from cell.usual_delays import ARM_LATE_S, CAMERA, ENCODER_LATE_S
from fakes.object import run_virtual
from procedures.belt.items import CONTACT
from tests.kit.object_cell import ObjectCell, on_disk, open_cell
from tests.kit.picking_cell import CAMERA_COV, JOB, picking_config

SCALE, TURN_RAD = 3e-4, 3e-4  # standard deviations of a belt's calibration
DELAY_S = 5e-4  # of a delay that was measured
_SIGMAS95 = 1.96
_SAME_S = 0.5  # between a contact's time by the job and by the world


@dataclass(frozen=True)
class Stated:
    """One contact: item beside the tool (2,) as it truly was, and the 95 % that the pick's record has, m."""

    off: Array
    r95_m: float

    @property
    def inside(self) -> bool:
        return float(np.linalg.norm(self.off)) <= self.r95_m


@dataclass
class StatedRun:
    """What one run came to."""

    contacts: list[Stated] = field(default_factory=list)
    answer: dict[str, Any] = field(default_factory=dict)
    outcome: str = ""


def stated_run(
    folder: Path,
    seed: int,
    world: dict[str, str],
    job: dict[str, Any],
    seconds: float,
    measured: bool = True,
) -> StatedRun:
    """Pick for ``seconds`` in the shipped ``picking`` with ``world`` in place of its lines. Camera, belt and
    delays were calibrated, and each is off by what ``seed`` draws from the uncertainty that it states.

    Where no delay was ``measured``, camera, encoder and arm are as late as such devices usually are."""
    rng = np.random.default_rng([seed, 0xC0])
    camera_off = rng.multivariate_normal(np.zeros(6), CAMERA_COV)
    scale, turn = SCALE * rng.standard_normal(), TURN_RAD * rng.standard_normal()
    late = {"stamp_late_s": str(DELAY_S * rng.standard_normal())} if measured else _usual(rng)
    lines = {"seed": str(seed), **late, **world}
    config = picking_config(folder, job, lines, real=True, as_shipped=True)
    found = StatedRun()

    async def scene() -> None:
        async with open_cell(config, None, JOB) as cell:
            calibrate(cell, camera_off, scale, turn)
            half = _SIGMAS95 * DELAY_S
            if measured:
                _accept(cell, time_offset("camera"), 0.0, {"interval95_s": [-half, half]}, 0.0)
            run_id = await cell.start()
            end = cell.clock.now() + seconds
            while cell.engine.active and cell.clock.now() < end:
                await cell.clock.sleep(0.2)
            if cell.engine.active:
                await cell.engine.finish("bench")
            found.outcome = (await cell.finished(run_id))["outcome"]
            if found.outcome == "complete":
                found.answer = cell.result(run_id)["result"]
            found.contacts = contacts_of(cell, run_id)

    run_virtual(scene())
    return found


def _usual(rng: np.random.Generator) -> dict[str, str]:
    """How late stamps are that nobody measured."""
    arm = rng.uniform(*ARM_LATE_S)
    camera = CAMERA.sigma_s * rng.standard_normal()
    encoder = rng.uniform(*ENCODER_LATE_S)
    # The arm's has the camera's key, so it comes after it, beside a key of its own.
    of_arm = {"force_walk_n": f"2.0\nstamp_late_s = {arm}"}
    return {"stamp_late_s": str(camera), "late_s": str(encoder), **of_arm}


def calibrate(cell: ObjectCell, camera_off: Array, scale: float = 0.0, turn_rad: float = 0.0) -> None:
    """Calibrate camera and belt so that they are off by ``camera_off`` (6,), ``scale`` and ``turn_rad``."""
    _calibrate_camera(cell, camera_off)
    belt = cell.config.robot.belt_nominal
    assert belt is not None
    _accept(cell, belt_scale("belt"), *belt_result(belt.scale, belt.dir, scale, turn_rad))


def belt_result(
    m_per_count: float, way: list[float], scale: float = 0.0, turn_rad: float = 0.0
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Of a belt that truly is as configured: the value by a calibration that is off by ``scale`` and
    ``turn_rad``, what its result states, and the configured value."""
    m = m_per_count * (1.0 + scale)
    half = _SIGMAS95 * SCALE * m
    stated = {"m_per_count_95": [m - half, m + half], "dir_95_rad": _SIGMAS95 * TURN_RAD}
    return {"m_per_count": m, "dir": _turned(way, turn_rad)}, stated, {"m_per_count": m_per_count, "dir": way}


def _calibrate_camera(cell: ObjectCell, off: Array) -> None:
    drawn, truth = cell.config.robot.T_base_camera_nominal, cell.plant.world.truth()["T_base_camera"]
    pose = to_pose6(from_pose6(truth) * RigidTransform.from_matrix(se3.exp(off))).tolist()
    known = {"lens": asdict(cell.plant.world.intrinsics), "cov": CAMERA_COV, "budget": []}
    _accept(cell, "T_base_camera", pose, known, drawn)


def _accept(cell: ObjectCell, name: str, value: Any, stated: dict[str, Any], configured: Any) -> None:
    on_disk(cell.ledger.accept, cell.ledger.propose(name, value, {"result": stated}, 0, configured), "bench")


def _turned(way: list[float], by_rad: float) -> list[float]:
    x, y, z = way
    c, s = np.cos(by_rad), np.sin(by_rad)
    return [float(c * x - s * y), float(s * x + c * y), z]


def contacts_of(cell: ObjectCell, run_id: int) -> list[Stated]:
    """The first contacts of a run's items as the world has them, each with what its record states."""
    gripper = cell.plant.world.gripper
    assert gripper is not None
    gripper.settle(cell.clock.now())
    met = [c for c in gripper.contacts if c.t_contact is not None and c.off_m is not None]
    out = []
    for line in cell.notes(run_id, "item"):
        if "contact_95_m" not in line:
            continue
        at = next(t for t, what in line["history"] if what == CONTACT)
        first = min(met, key=lambda c: abs((c.t_contact or 0.0) - at), default=None)
        if first is not None and first.off_m is not None and abs((first.t_contact or 0.0) - at) < _SAME_S:
            out.append(Stated(np.array(first.off_m), line["contact_95_m"]))
    return out
