"""An arm that is millimetres off, measured on the wire: ur-rtde moves it, the tracker speaks GeoCOM."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.store.files import read_json, to_json
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.plan import PlanRequest, plan_sampling
from tests.kit.ideal_world import ideal_text
from tests.kit.solved import solve_kincal
from tests.kit.tracker_cell import nominal_tracker, reflectors, rms, true_errors
from tests.kit.wire_cell import WireCell, wait_for, wire_cell
from tests.unit.procedures.test_iso9283_job import CENTRE, EDGE, POINT, towards_the_tracker
from tests.unit.procedures.test_tracker_sampling_plan import HOME, measured, values

pytestmark = [pytest.mark.wire, pytest.mark.alone]

JOB = "tracker-sampling"
LIMITS = """
[cell.limits]
speed_m_s = 1.0
accel_m_s2 = 5.0
joint_speed_rad_s = [2.0, 2.0, 3.0, 3.0, 3.0, 3.0]
joint_accel_rad_s2 = 24.0
workspace = [{ min = [-1.4, -1.4, 0.0], max = [1.4, 1.4, 1.8] }]
"""
SECTION = """
[cell.job.tracker-sampling]
poses = 10
held_out_share = 0.0
locate_poses = 3
monument_every = 10
settle_s = 0.1
window_s = 0.2
max_scatter_m = 0.0005
find_timeout_s = 5.0
max_predicted_m = 0.01
T_base_tracker_nominal = {place}
accept = {{ max_error_m = 0.01, auto = true }}
[cell.job.tracker-sampling.reflectors.smr1]
point = [-0.05, 0.0, 0.06]
normal = [0.0, 0.0, 1.0]
half_angle_rad = 0.9
[cell.job.tracker-sampling.monuments.m1]
point = [0.35, 0.35, 0.02]
[cell.job.tracker-sampling.monuments.m2]
point = [0.35, -0.35, 0.02]
[cell.job.tracker-sampling.monuments.m4]
point = [0.10, -0.60, 0.45]
"""
STORED = 34
CYCLES = 3
ISO9283 = f"""
[cell.job.iso9283]
reflector = "smr1"
point = {POINT.tolist()}
cube = {{ centre = {CENTRE.tolist()}, edge_m = {EDGE}, R_base_flange = {towards_the_tracker()} }}
cycles = {CYCLES}
settle_s = 0.05
window_s = 0.2
max_scatter_m = 0.0005
find_timeout_s = 5.0
T_base_tracker_nominal = {nominal_tracker("tracker")}
"""


def scenario() -> str:
    """The shipped one with short plans, brisk moves and quick searches; what is true in it stays as it is."""
    text = ideal_text("tracker").replace("[world.tracker]\n", "[world.tracker]\nsearch_s = 0.05\n")
    text = text.split("[cell.limits]")[0]
    return text + LIMITS + SECTION.format(place=nominal_tracker("tracker")) + ISO9283


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WireCell]:
    with wire_cell(tmp_path_factory.mktemp("tracker"), "127.0.44.2", scenario()) as made:
        yield made


def arrivals(folder: Path) -> dict[str, Any]:
    """(n, 3) by pose, in the tracker frame: from the lines that were written at each arrival."""
    by_pose: dict[str, list[list[float]]] = {}
    for line in (folder / "samples.jsonl").read_text("utf-8").splitlines():
        sample = json.loads(line)
        by_pose.setdefault(sample["pose"], []).append(sample["p_tracker"])
    return {name: np.array(p) for name, p in by_pose.items()}


def wanted(pose: dict[str, Any]) -> Any:
    """(3,): where the reflector was sent, in the base."""
    x, y, z, *turn = pose["T_base_flange"]
    return np.array([x, y, z]) + Rotation.from_rotvec(turn).apply(POINT)


@pytest.mark.restarts_children
def test_AP_and_RP_on_the_wire_are_those_of_the_plain_formulas_and_of_the_true_arm(cell: WireCell) -> None:
    run_id = cell.start_job("iso9283")
    end = cell.undisturbed_end(90.0)
    assert (end["run_id"], end["outcome"]) == (run_id, "complete"), end
    folder = next(r for r in cell.runs() if r.run_id == run_id).path
    answer = read_json(folder / "result.json")["result"]
    poses = {pose["name"]: pose for pose in read_json(folder / "iso9283.json")["poses"]}
    measured = arrivals(folder)
    assert [len(measured[name]) for name in ("P1", "P2", "P3", "P4", "P5")] == [CYCLES] * 5

    # The tracker's place, from all barycentres: a turn about their middles (Kabsch), then a shift.
    names = sorted(poses)
    there = np.array([measured[name].mean(axis=0) for name in names])
    sent = np.array([wanted(poses[name]) for name in names])
    turn, _ = Rotation.align_vectors(sent - sent.mean(axis=0), there - there.mean(axis=0))
    world = World.from_scenario(Scenario.load("tracker:ideal"))
    true = np.array([world.true.forward(np.array(poses[name]["q"])).apply(POINT) for name in names])
    back, _ = Rotation.align_vectors(sent - sent.mean(axis=0), true - true.mean(axis=0))

    for pose in answer["poses"]:
        at = turn.apply(measured[pose["name"]] - there.mean(axis=0)) + sent.mean(axis=0)
        barycentre = at.sum(axis=0) / CYCLES
        distance = np.sqrt(((at - barycentre) ** 2).sum(axis=1))
        middle = distance.sum() / CYCLES
        spread = np.sqrt(((distance - middle) ** 2).sum() / (CYCLES - 1))
        AP = np.sqrt(((barycentre - wanted(poses[pose["name"]])) ** 2).sum())
        RP = middle + 3.0 * spread
        assert pose["AP_measured"] == pytest.approx(AP, abs=1e-9)
        assert pose["RP_measured"] == pytest.approx(RP, abs=1e-9)
        assert pose["AP"] == max(pose["AP_measured"], pose["AP_tracker"])
        assert pose["RP"] == max(pose["RP_measured"], pose["RP_tracker"])
        k = names.index(pose["name"])
        off = back.apply(true[k] - true.mean(axis=0)) + sent.mean(axis=0) - sent[k]
        assert pose["deviation"] == pytest.approx(off, abs=0.0001), "of what the twin's own arm does"
    assert answer["AP_max"] > 0.0005, "the arm of this twin is two millimetres off"
    cell.stays_at_rest(0.3)


def stored_set() -> list[dict[str, Any]]:
    """Poses that were planned and read earlier: by the twin's own kinematics, with the tracker's noise."""
    job = {"reflectors": reflectors("tracker", "smr1"), "poses": STORED, "held_out_share": 0.0}
    config = TrackerSamplingConfig.model_validate(job).model_dump()
    noise = {"sigma0": 15e-6, "sigma_per_m": 6e-6}
    plan = plan_sampling(PlanRequest(values(), config, noise, nominal_tracker("tracker"), HOME))
    Q = np.array([visit.q for visit in plan.visits])
    p = measured(World.from_scenario(Scenario.load("tracker:ideal")), Q, np.random.default_rng(5))
    return [
        {"q": q.tolist(), "p_tracker": point.tolist(), "target": "smr1"}
        for q, point in zip(Q, p.T, strict=True)
    ]


@pytest.mark.restarts_children
def test_an_arm_comes_from_two_millimetres_to_fifty_micrometres_with_a_stored_set(cell: WireCell) -> None:
    run_id = cell.start_job(JOB)
    end = cell.wait_for_end(120.0)
    assert (end["run_id"], end["outcome"]) == (run_id, "complete"), end
    folder = next(r for r in cell.runs() if r.run_id == run_id).path
    data = read_json(folder / "kincal.json")
    assert len(data["samples"]) == 10
    looked = read_json(folder / "result.json")["inputs"]["sampling"]["monuments"]
    assert looked["max_moved_m"] < looked["limit_m"]
    cell.stays_at_rest(0.3)

    # Ten poses are hardly more numbers than unknowns; with a stored set they tell what forty tell.
    together = {**data, "samples": [*data["samples"], *stored_set()]}
    path = cell.folder / "together.json"
    path.write_text(to_json(together), "utf-8")
    result = solve_kincal(path)
    assert result["verdict"] in ("pass", "warn"), result["reasons"]
    assert not result["result"]["rejected"], "what was read on the wire agrees with what was stored"
    assert 0.0015 < result["result"]["rms_registration_only"] < 0.003
    Q = np.array([s["q"] for s in together["samples"]])
    elsewhere = np.random.default_rng(8).uniform(Q.min(axis=0), Q.max(axis=0), (150, 6))
    assert rms(true_errors(World.from_scenario(Scenario.load("tracker:ideal")), result, elsewhere)) <= 0.00005


@pytest.mark.soak  # the same on virtual time is in the unit tests
@pytest.mark.restarts_children
def test_a_stand_that_is_pushed_is_named_on_the_wire(cell: WireCell) -> None:
    run_id = cell.call("start", job=JOB, params={"monument_every": "2"})["run_id"]
    wait_for(lambda: cell.status()["step"] >= 1, "a pose", 60.0)
    cell.inject("tracker", "stand-moved", dx=0.001)
    end = cell.wait_for_end(120.0)
    assert end["run_id"] == run_id
    assert (end["outcome"], end["error"]["name"]) == ("aborted", "TRACKER_MOVED"), end
    cell.stays_at_rest(0.5)
