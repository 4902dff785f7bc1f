"""Geometry and plan of a crossed-beam scan: where it goes, what the guard says, and what is refused."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform

from calibration.kinematics import robot_from_spec
from cell.errors import InputError
from cell.run_values import RunValues
from daemon.config import load_config
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from procedures.laser.config import BeamSection, LaserReferenceConfig, Search
from procedures.laser.path import course, deepest
from procedures.laser.plan import PlanRequest, check_plan, plan_scan
from procedures.laser.scan_progress import ScanProgress, most_pairs
from tests.kit.laser_cell import BRISK, laser_cell, laser_config
from tests.kit.object_cell import no_report, refused

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

SHIPPED = Scenario.load("laser:ideal").cell
SECTION = SHIPPED.job["laser-reference"]
ROBOT = {"model": "ur10e"}
MODEL = robot_from_spec(ROBOT)
TOOL = {"name": "pin", "T_flange_tool": [0.0, 0.0, 0.18, 0.0, 0.0, 0.0], "radius_m": 0.02}


def search(**keys: Any) -> Search:
    config = LaserReferenceConfig.model_validate({**SECTION, **keys})
    return Search.from_config(config, SHIPPED.poses, "beams")


def plan(
    tool: dict[str, Any] | None = None,
    limits: dict[str, Any] | None = None,
    q: list[float] | None = None,
    retract: str | None = None,
    **keys: Any,
) -> Any:
    values = RunValues(
        robot=ROBOT,
        tool=tool or TOOL,
        payload_kg=1.0,
        limits={"joint_accel_rad_s2": 1.4, **SHIPPED.limits, **(limits or {})},
        poses={**SHIPPED.poses, "far": [SHIPPED.poses["home"][0] - 1.5, *SHIPPED.poses["home"][1:]]},
    )
    q = q or list(SHIPPED.poses["home"])
    return plan_scan(PlanRequest(values, search(**keys).model_dump(), None, 2, q, retract))


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"across": [0.0, 0.0, 1.0]}, "level"),
        ({"across": [0.0, 0.0, 0.0]}, "level"),
        ({"along_m": 0.03}, "0.04 m or more"),
    ],
)
def test_a_beam_that_cannot_be_measured_is_refused_when_the_config_is_read(
    keys: dict[str, Any], told: str
) -> None:
    with pytest.raises(ValidationError, match=told):
        BeamSection.model_validate({**SECTION["xs"], **keys})


def test_edges_come_in_pairs() -> None:
    with pytest.raises(ValidationError, match="even number"):
        search(edges=3)


def test_the_second_place_is_along_the_beam_in_the_same_attitude() -> None:
    way = course(search(), MODEL, TOOL["T_flange_tool"], None, 2)
    first, second, other, _ = way.stations
    assert (first.beam, first.place, second.place, other.beam) == ("xs", 0, 1, "ys")
    step = second.start.translation - first.start.translation
    assert step == pytest.approx([-0.05, 0.0, 0.0], abs=1e-9)
    for station in way.stations:
        assert (station.start.rotation.inv() * first.start.rotation).magnitude() < 1e-9
    assert first.at(0.01, 0.02).translation - first.start.translation == pytest.approx([0.0, 0.01, -0.02])


def test_another_tool_s_point_follows_the_path_of_the_reference_s() -> None:
    bent = [0.001, -0.002, 0.19, 0.01, 0.0, 0.0]
    p_ref = [0.0, 0.0, 0.18]
    before = course(search(), MODEL, TOOL["T_flange_tool"], p_ref, 2)
    after = course(search(), MODEL, bent, p_ref, 2)
    for a, b in zip(before.stations, after.stations, strict=True):
        assert after.tip(b.start) == pytest.approx(before.tip(a.start), abs=1e-12)
        assert not b.taught
    assert before.stations[0].taught


def test_auxiliary_points_in_two_attitudes_are_refused() -> None:
    poses = {**SHIPPED.poses, "aux_ys": [*SHIPPED.poses["aux_ys"][:5], SHIPPED.poses["aux_ys"][5] + 0.05]}
    config = LaserReferenceConfig.model_validate(SECTION)
    with pytest.raises(Exception, match=r"'aux_xs' and 'aux_ys' differ by 2.9 deg"):
        course(Search.from_config(config, poses, "beams"), MODEL, TOOL["T_flange_tool"], None, 1)


def test_the_search_leaves_room_to_measure_above_the_floor() -> None:
    way = course(search(), MODEL, TOOL["T_flange_tool"], None, 1)
    station = way.stations[0]
    high = way.tip(station.start)[2]
    tight = search(floor_m=float(high) - 0.041)
    assert deepest(tight, way, station) == pytest.approx(0.041 - 0.006 - 0.025)
    assert deepest(search(max_descents=3), way, station) == pytest.approx(0.015)


def test_every_sweep_down_to_the_limit_is_listed_with_what_the_guard_says() -> None:
    found = plan(max_descents=2)
    assert found["problems"] == []
    rows = [row for row in found["sweeps"] if row["index"].startswith("xs 1") and row["sweeps"]]
    assert [(round(row["depth_m"], 4), row["sweeps"]) for row in rows] == [
        (0.0, 1),
        (-0.005, 1),
        (-0.01, 1),
        (0.005, 1),
        (0.01, 1),
        (0.016, 1),
        (0.01, 8),  # as many as halve 5 mm until 0.02 mm
        (0.016, 8),
        (0.041, 1 + 8),
    ]
    model = MODEL
    for row in rows:
        length = np.linalg.norm(np.array(row["to"]) - row["from"])
        assert length == pytest.approx(0.03)
        tip = model.forward(np.array(row["q"])).apply(np.array([0.0, 0.0, 0.18]))
        assert tip == pytest.approx(row["from"], abs=1e-6) or tip == pytest.approx(row["to"], abs=1e-6)
        assert row["checks"]["floor_m"] > 0.0
    assert sum(row["sweeps"] for row in found["sweeps"]) > 4 * 2 * 8
    way, if_met_at_once = course(search(), model, TOOL["T_flange_tool"], None, 1), 2
    counted = most_pairs(search(max_descents=2), way, way.stations[0])
    assert sum(counted) == sum(row["sweeps"] for row in rows) - if_met_at_once
    assert counted[1] == 8 + 1 + 8, "measured, located lower down, and measured there"


def test_a_scan_counts_all_its_ways_at_its_end_also_where_a_beam_was_not_found() -> None:
    run: Any = SimpleNamespace(step=3, steps=0)
    run.progress = lambda step, steps: run.__dict__.update(step=step, steps=steps)
    way = course(search(), MODEL, TOOL["T_flange_tool"], None, 2)
    subject = ScanProgress(run, search(), way, 1)
    subject.find(way.stations[0])  # and not found: the second beam is left out
    subject.count()
    assert 3 < run.step < run.steps
    subject.end()
    assert run.step == run.steps == 3 + sum(sum(most_pairs(search(), way, one)) for one in way.stations)


def test_the_moves_are_listed_in_the_order_in_which_they_are_made() -> None:
    found = plan(max_descents=1, retract="home")
    names = [row["index"] for row in found["sweeps"]]
    assert names == [
        "xs approach",
        "xs 1 at 0.0 mm",
        "xs 1 at -5.0 mm, if met at once",
        "xs 1 at -10.0 mm, if met at once",
        "xs 1 at 5.0 mm",
        "xs 1 at 11.0 mm or higher, located",
        "xs 1 at 5.0 mm or higher, search in height",
        "xs 1 at 11.0 mm or higher, measured",
        "xs 1 at 36.0 mm or higher, measured",
        "xs 1 lift",
        "xs 1 back",
        "xs 2 start",
        *(n for n in names if n.startswith("xs 2 at")),
        "xs 2 lift",
        "xs 2 back",
        "ys approach",
        *(n for n in names if n.startswith("ys 1 at")),
        "ys 1 lift",
        "ys 1 back",
        "ys 2 start",
        *(n for n in names if n.startswith("ys 2 at")),
        "ys 2 lift",
        "ys 2 back",
        "retract",
    ]
    lift = next(row for row in found["sweeps"] if row["index"] == "xs 1 lift")
    assert np.array(lift["to"]) - lift["from"] == pytest.approx([0.0, 0.0, 0.036], abs=1e-9)
    assert found["problems"] == []


def test_a_tool_that_stands_between_the_sensors_is_lifted_first() -> None:
    model = MODEL
    beside = np.array(SHIPPED.poses["aux_xs"])
    aux = model.forward(beside)
    low = RigidTransform.from_components(aux.translation - [0.0, 0.0, 0.02], aux.rotation)
    q = model.inverse(low, beside)
    assert q is not None
    first, second, *_ = plan(q=q.tolist(), max_descents=1)["sweeps"]
    assert (first["index"], second["index"]) == ("lift out of the fixture", "xs approach")
    assert np.array(first["to"]) - first["from"] == pytest.approx([0.0, 0.0, 0.02], abs=1e-6)


def test_a_box_in_the_way_of_the_retract_is_found() -> None:
    post = {"name": "post", "min": [-0.05, 0.5, 0.2], "max": [0.05, 0.9, 0.8]}
    assert plan(limits={"keep_out": [post]}, max_descents=1)["problems"] == []
    (problem,) = plan(limits={"keep_out": [post]}, max_descents=1, retract="far")["problems"]
    assert problem.startswith("retract: ")
    assert "'post'" in problem


def test_the_guard_sees_the_tool_longer_than_it_is_believed_to_be() -> None:
    under = [{"min": [-1.3, -1.3, 0.195], "max": [1.3, 1.3, 1.8]}]
    keys = {"max_descents": 2, "floor_m": 0.0}
    assert plan(limits={"workspace": under}, tool_margin_m=0.005, **keys)["problems"] == []
    found = plan(limits={"workspace": under}, tool_margin_m=0.03, **keys)
    assert "'pin' and the workspace" in found["problems"][0]
    with pytest.raises(
        Exception, match=r"cannot be crossed within the limits: xs 1 at 41\.0 mm or higher, measured"
    ):
        check_plan(found)


def test_a_box_in_the_way_of_the_second_place_is_named() -> None:
    box = {"name": "post", "min": [-0.52, 0.38, 0.0], "max": [-0.49, 0.5, 0.3]}
    found = plan(limits={"keep_out": [box]}, max_descents=2)
    assert any("xs 2" in p and "'post'" in p for p in found["problems"])


def test_an_auxiliary_point_too_low_leaves_no_room(tmp_path: Path) -> None:
    async def main() -> None:
        config = laser_config(tmp_path, reference={"floor_m": 0.255})
        async with laser_cell(config, "laser-reference") as cell:
            shown = await cell.dry_run()
            assert "no room to search: the point is 3.0 mm above the floor" in shown["plan"]["problems"][0]
            end = await cell.run_job()
            assert end["error"]["name"] == "LASER_PLAN_REFUSED"
            assert not [line for line in cell.journal(2) if line["kind"] == "motion"]

    run_virtual(main())


def test_a_dry_run_lists_the_sweeps_and_moves_nothing(tmp_path: Path) -> None:
    async def main() -> None:
        async with laser_cell(laser_config(tmp_path), "laser-reference") as cell:
            before = cell.plant.world.track.at(cell.clock.now())[0]
            shown = await cell.dry_run()
            assert {row["index"] for row in shown["plan"]["sweeps"]} >= {
                "xs approach",
                "xs 1 at 0.0 mm",
                "ys 2 at 16.0 mm",
            }
            assert shown["plan"]["problems"] == []
            assert np.array_equal(cell.plant.world.track.at(cell.clock.now())[0], before)
            assert not [n for n in cell.journal(shown["run_id"]) if n["kind"] == "motion"]

    run_virtual(main())


@pytest.mark.parametrize(
    ("params", "name", "told"),
    [
        ({"search_speed_m_s": "0.45"}, "MOTION_LIMIT", "search_speed_m_s is 0.45 m/s"),
        ({"retract_pose": "nowhere"}, "ARGUMENT_INVALID", "retract_pose 'nowhere' is not in [poses]"),
    ],
)
def test_what_cannot_be_is_refused_at_the_start(
    params: dict[str, str], name: str, told: str, tmp_path: Path
) -> None:
    async def main() -> None:
        config = laser_config(tmp_path, limits={**BRISK, "speed_m_s": 0.4})
        async with laser_cell(config, "laser-reference") as cell:
            refusal = await refused(cell.start(params=params))
            assert refusal.name == name
            assert told in str(refusal)
            assert cell.ledger.runs() == []

    run_virtual(main())


def test_an_auxiliary_point_that_nobody_taught_is_found_when_the_config_is_read(tmp_path: Path) -> None:
    laser_config(tmp_path, reference={"xs": {**SECTION["xs"], "aux": "aux_x"}})
    (file,) = tmp_path.glob("*.toml")
    (problem,) = [text for text in load_config(file).problems if "xs.aux" in text]
    assert "there is no 'aux_x' in [poses]" in problem


def test_an_input_that_the_device_does_not_have_is_found_when_the_config_is_read(tmp_path: Path) -> None:
    config = (
        'schema = 1\n[robot]\nbeams = "io"\n[device.io]\ndriver = "modbus-inputs"\n'
        'url = "tcp://127.0.0.1:502"\nmodule = "ioLogik-E1210"\n'
        "inputs = { xs = { address = 0 }, ys = { address = 1 } }\n"
        '[job.laser-reference]\nxs = { input = "xz" }\n'
    )
    file = tmp_path / "cell.toml"
    file.write_text(config)
    with pytest.raises(InputError, match=r"xs\.input: \[device\.io\] has no input 'xz'; it has xs, ys"):
        load_config(file)


def test_the_role_of_the_beams_goes_to_a_device_with_inputs(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(
        'schema = 1\n[robot]\nbeams = "arm"\n[device.arm]\ndriver = "ur"\nhost = "127.0.0.2"\n'
        "[limits]\nworkspace = [{ min = [-1, -1, 0], max = [1, 1, 1] }]\n"
    )
    needs = r"robot\.beams: the role 'beams' needs a group of digital inputs, but \[device\.arm\] is an arm"
    with pytest.raises(InputError, match=needs):
        load_config(file)


def test_both_beams_on_one_input_are_refused() -> None:
    with pytest.raises(ValidationError, match="xs and ys have the same input 'xs'"):
        LaserReferenceConfig.model_validate({**SECTION, "ys": {**SECTION["ys"], "input": "xs"}})


@pytest.mark.parametrize(("degrees", "refused_"), [(5.0, True), (7.0, False), (173.0, False), (175.0, True)])
def test_ways_across_that_are_nearly_parallel_are_refused(degrees: float, refused_: bool) -> None:
    x, y, _ = SECTION["xs"]["across"]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turned = {**SECTION, "ys": {**SECTION["ys"], "across": [c * x - s * y, s * x + c * y, 0.0]}}
    if refused_:
        with pytest.raises(ValidationError, match="nearly along each other"):
            LaserReferenceConfig.model_validate(turned)
    else:
        LaserReferenceConfig.model_validate(turned)


@pytest.mark.parametrize("job", ["laser-check", "laser-update"])
def test_without_a_reference_for_this_tool_nothing_is_measured(job: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with laser_cell(laser_config(tmp_path), job) as cell:
            refusal = await refused(cell.start())
            assert refusal.name == "LASER_NO_REFERENCE"
            assert "'pin'" in str(refusal)

    run_virtual(main())
