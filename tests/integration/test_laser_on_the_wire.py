"""A bent tool in the twin: genuine ur-rtde moves it, pymodbus polls the beams, the daemon puts it right."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from cell.poses import from_pose6, to_pose6
from cell.store.ledger import Ledger
from fakes.twin.control import ask
from tests.kit.wire_cell import PATIENT_DEVICES, WireCell, shipped, wait_for, wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.alone]

SHIFT = [0.0012, -0.0007, 0.0005]
TILT = [0.008, -0.006, 0.0]  # 10 mrad
# A brisk arm, one pass a height, and heights to 0.3 mm: seconds instead of minutes, and still U < 0.2 mm.
QUICK = {
    "passes": 1,
    "descend_step_m": 0.01,
    "z_resolution_m": 0.0003,
    "search_speed_m_s": 0.25,
    "measure_speed_m_s": 0.04,
    "speed_m_s": 1.0,
    "accel_m_s2": 10.0,
    "joint_speed_rad_s": [2.0, 2.0, 3.0, 3.0, 3.0, 3.0],
}
MORE = """
lead_m = 0.002
settle_s = 0.01
retries = 12
accept = { auto = true }
[cell.job.laser-update]
accept = { auto = true }
"""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WireCell]:
    scenario = shipped("laser", **QUICK) + MORE
    with wire_cell(tmp_path_factory.mktemp("laser"), "127.0.0.62", scenario, limits=PATIENT_DEVICES) as made:
        yield made


def run_job(cell: WireCell, job: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The run's end and its result."""
    run_id = cell.start_job(job)
    end = cell.undisturbed_end(180.0)
    assert end["run_id"] == run_id
    folder = next(r for r in cell.runs() if r.run_id == run_id)
    return end, folder.read_result() or {}


@pytest.mark.restarts_children
def test_a_bent_tool_is_measured_proposed_accepted_and_meets_the_reference_in_the_second_scan(
    cell: WireCell,
) -> None:
    end, _ = run_job(cell, "laser-reference")
    assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end
    before = from_pose6(ask(cell.folder, {"do": "truth"})["T_flange_tool"])
    ask(cell.folder, {"do": "tool", "bend": [*SHIFT, *TILT]})
    true = from_pose6(ask(cell.folder, {"do": "truth"})["T_flange_tool"])
    assert np.linalg.norm(true.translation - before.translation) > 0.001

    end, result = run_job(cell, "laser-update")
    assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end
    found, U = from_pose6(result["result"]["T_flange_tool"]), result["uncertainty"]
    # 95 % limits widened to what is exceeded once in a thousand.
    assert np.linalg.norm(found.translation - true.translation) < 1.5 * U["U_point_m"]
    axes = [T.rotation.as_matrix()[:, 2] for T in (found, true)]
    assert np.linalg.norm(np.cross(*axes)) < 1.6 * U["U_tilt_rad"]
    assert U["U_point_m"] < 0.0002
    second = result["inputs"]["update"]["second_scan"]
    assert second["meets"]
    assert second["apart"] <= second["U_m"]

    ledger = Ledger(cell.folder / "state" / "ledger.sqlite", read_only=True)
    committed = ledger.results("T_flange_tool.pin")
    ledger.close()
    assert [r["state"] for r in committed] == ["committed"]
    assert np.allclose(committed[0]["value"], to_pose6(found), atol=1e-12)
    cell.stays_at_rest(0.3)


@pytest.mark.restarts_children
def test_a_module_that_is_away_for_long_in_mid_pass_ends_the_run_with_the_arm_at_rest(cell: WireCell) -> None:
    run_id = cell.start_job("laser-check")
    wait_for(lambda: cell.status()["state"] == "return", "the way back of a pass", 60.0)
    cell.inject("beams", "reboot", boot_s=8.0)
    end = cell.wait_for_end(60.0)
    assert end["run_id"] == run_id
    assert end["outcome"] == "aborted"
    assert end["error"]["name"] in ("DEVICE_LOST", "MODULE_REBOOTED"), end["error"]
    cell.stays_at_rest(0.5)
