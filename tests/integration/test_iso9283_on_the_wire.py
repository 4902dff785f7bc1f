"""AP and RP measured on the wire, worked out again from the raw data by the standard's plain formulas."""

import json
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.store.files import read_json
from fakes.scenario import Scenario
from fakes.world import World
from tests.integration.test_tracker_on_the_wire import LIMITS
from tests.unit.test_iso9283_job import CENTRE, EDGE, POINT, towards_the_tracker
from tests.unit.tracker_cell import nominal_tracker
from tests.wire_cell import WireCell, wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.alone]

CYCLES = 3
SECTION = f"""
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


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WireCell]:
    text = files("fakes").joinpath("scenarios/tracker.toml").read_text("utf-8").split("[cell.limits]")[0]
    with wire_cell(tmp_path_factory.mktemp("iso"), "127.0.72.2", text + LIMITS + SECTION) as made:
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
    end = cell.wait_for_end(90.0)
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
    world = World.from_scenario(Scenario.load("tracker"))
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
