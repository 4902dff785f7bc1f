"""Whole samplings on the wire, with as many poses as a cell would take: both arms to fifty micrometres."""

from pathlib import Path

import numpy as np
import pytest

from cell.store.files import read_json
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.ideal_world import ideal_text
from tests.kit.tracker_cell import nominal_tracker, rms, true_errors
from tests.kit.wire_cell import wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.soak]

POSES = 44
SECTION = """
poses = {poses}
settle_s = 0.2
window_s = 0.3
max_scatter_m = 0.0005
find_timeout_s = 5.0
T_base_tracker_nominal = {place}
"""
BEFORE_M = {"tracker": (0.0015, 0.003), "palletizer": (0.003, 0.0045)}


def scenario(name: str) -> str:
    """The shipped one with quicker measurements; its truth, reflectors and monuments stay as they are."""
    text = ideal_text(name)
    head, section = text.split("[cell.job.tracker-sampling]\n", 1)
    kept = [line for line in section.splitlines() if not line.startswith(("poses", "T_base_tracker_nominal"))]
    own = SECTION.format(poses=POSES, place=nominal_tracker(name))
    return f"{head}[cell.job.tracker-sampling]{own}" + "\n".join(kept) + "\n"


@pytest.mark.parametrize("name", ["tracker", "palletizer"])
def test_an_arm_comes_from_millimetres_to_fifty_micrometres_on_the_wire(name: str, tmp_path: Path) -> None:
    with wire_cell(tmp_path, "127.0.44.3", scenario(name)) as cell:
        run_id = cell.start_job("tracker-sampling")
        end = cell.wait_for_end(600.0)
        assert (end["run_id"], end["outcome"]) == (run_id, "complete"), end
        folder = next(r for r in cell.runs() if r.run_id == run_id).path
        result = read_json(folder / "result.json")
        Q = np.array([s["q"] for s in read_json(folder / "kincal.json")["samples"]])
    low, high = BEFORE_M[name]
    accuracy = result["result"]["absolute_accuracy"]
    assert low < accuracy["before"] < high
    elsewhere = np.random.default_rng(8).uniform(Q.min(axis=0), Q.max(axis=0), (150, Q.shape[1]))
    off = rms(true_errors(World.from_scenario(Scenario.load(f"{name}:ideal")), result, elsewhere))
    read, own = accuracy["after"], result["heldout"]["tracker_3d"]
    print(
        f"{name}: {1e3 * accuracy['before']:.3f} mm before; {1e3 * off:.4f} mm off the truth, "
        f"{1e3 * read:.4f} mm off the readings (sqrt(3) sigma: {1e3 * own:.4f} mm)"
    )
    assert off <= 0.00005
