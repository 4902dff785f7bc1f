"""Calibrating a belt in a whole cell on virtual time: the answer beside the truth, and refusals by name."""

from collections.abc import Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.store.files import read_json, to_json, write_atomic
from daemon.cli.replay import differences
from daemon.demo.ending import beside_truth
from fakes.object import run_virtual
from fakes.world.world import World
from procedures.belt.calibrating.rows import ItemFollower
from tests.kit.belt_teacher import Teacher
from tests.kit.object_cell import ObjectCell, no_report, refused
from tests.kit.picking_cell import TELLS_WRONG, picking_cell, picking_config
from tests.kit.solved import solve_again, solve_belt

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")
JOB = "belt-calibration"
TOUCH = {"source": "touch"}


@asynccontextmanager
async def belt_cell(folder: Path, world: Mapping[str, str] | None = None) -> Any:
    async with picking_cell(picking_config(folder, world=world)) as cell:
        cell.job = JOB
        yield cell


def answer(cell: ObjectCell, run_id: int) -> dict[str, Any]:
    """The run's result, which solving its data again gives as well."""
    folder, recorded = cell.folder(run_id), cell.result(run_id)
    again = solve_again(folder.job, folder.path, folder.info, recorded)
    assert differences(recorded, again) == []
    return recorded


def assert_true(cell: ObjectCell, result: Mapping[str, Any]) -> None:
    """Scale and direction are those of the world, within what the result itself says."""
    belt = cell.plant.world.belt
    assert belt is not None
    found = result["result"]
    low, high = found["m_per_count_95"]
    assert low <= belt.truth.m_per_count <= high
    turned = np.linalg.norm(np.cross(found["dir"], belt.direction))
    assert turned <= 1.5 * found["dir_95_rad"]  # the interval is for each of two planes
    assert float(np.dot(found["dir"], belt.direction)) > 0.99
    told = cell.plant.world.truth(cell.clock.now())
    assert beside_truth(result, told, cell.runs).good
    told["belt"]["m_per_count"] += 1.5 * (high - low)
    assert not beside_truth(result, told, cell.runs).good


@pytest.mark.parametrize(("m_per_count", "told"), [(1.013e-4, {}), (-0.991e-4, TELLS_WRONG)])
def test_the_interval_holds_the_true_scale_whichever_way_the_counter_goes(
    tmp_path: Path, m_per_count: float, told: dict[str, str]
) -> None:
    async def scene() -> None:
        world = {"m_per_count": f"{m_per_count!r}", "dir": "[0.9992, 0.03, 0.02]", "seed": "77", **told}
        async with belt_cell(tmp_path, world) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            result = answer(cell, run_id)
            assert result["verdict"] in ("pass", "warn"), result["reasons"]
            assert_true(cell, result)
            assert result["result"]["travel_m"] > 0.3
            assert result["uncertainty"]["half_m_per_count"] < 1e-3 * abs(m_per_count)
            assert 0.0 < result["heldout"]["rms_m"] < 0.5e-3
            assert cell.at_rest()
            kept.append((cell.folder(run_id), cell.plant.world))

    kept: list[tuple[Any, World]] = []
    run_virtual(scene())
    assert_lens_is_kept_and_missed(*kept[0])


def assert_lens_is_kept_and_missed(run: Any, world: World) -> None:
    """Without a lens in the calibration that of the camera is hardly known."""
    path, data = run.path / "belt.json", read_json(run.path / "belt.json")
    assert data["camera"]["lens"]["K"] == list(world.intrinsics.K)
    assert data["camera"]["told"]["K"] == list(world.told_intrinsics.K)
    data["camera"]["lens"] = None
    write_atomic(path, to_json(data))
    found = solve_belt(path, run.info["job_config"])
    assert found["verdict"] == "fail"
    assert (
        "mostly because the camera's calibration has no lens for these pictures: run cone-capture"
        in found["reasons"][0]
    )
    assert found["uncertainty"]["mostly_from"] == "lens"


def test_what_was_measured_takes_effect_when_it_is_accepted(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path, {"m_per_count": "1.01e-4"}) as cell:
            await cell.run_job()
            (row,) = [r for r in cell.ledger.results() if r["name"] == "belt.belt"]
            await cell.engine.decisions.accept(row["id"], "test")
            run_id = await cell.start()
            belt = cell.folder(run_id).info["values"]["belt"]
            assert belt["m_per_count"] == pytest.approx(1.01e-4, rel=1e-3)
            assert len(belt["dir"]) == 3
            await cell.engine.abort("test")
            await cell.finished(run_id)

    run_virtual(scene())


def test_a_standing_belt_is_refused_by_name(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path, {"profile": "[{ speed_m_s = 0.0 }]"}) as cell:
            run_id = await cell.start(params={"patience_s": 5.0})
            await cell.until(lambda: cell.engine.packml.name == "SUSPENDED", "suspended")
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            result = answer(cell, run_id)
            assert result["result"] is None
            assert result["reasons"][0].startswith("belt-stands:")
            assert not [r for r in cell.ledger.results() if r["name"] == "belt.belt"]

    run_virtual(scene())


def test_an_encoder_whose_wheel_stands_under_a_moving_belt_is_told_by_name(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            cell.plant.plant("belt").inject("stuck")
            run_id = await cell.start(params={"patience_s": 3.0})
            await cell.finished(run_id)
            assert answer(cell, run_id)["reasons"][0].startswith("encoder-stands:")

    run_virtual(scene())


def test_an_empty_belt_ends_by_name(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path, {"first_m": "9.0"}) as cell:
            run_id = await cell.start(params={"patience_s": 3.0})
            await cell.finished(run_id)
            assert answer(cell, run_id)["reasons"][0].startswith("too-few-sightings:")

    run_virtual(scene())


def test_a_belt_that_stops_half_way_is_waited_for(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 20, "sightings")
            belt = cell.plant.world.belt
            assert belt is not None
            belt.run(cell.clock.now(), 0.0)
            await cell.until(lambda: cell.engine.packml.name == "SUSPENDED", "suspended")
            await cell.clock.sleep(5.0)
            belt.resume(cell.clock.now())
            end = await cell.finished(run_id)
            assert end["verdict"] == "pass"
            assert_true(cell, answer(cell, run_id))

    run_virtual(scene())


def test_a_belt_that_ran_both_ways_is_warned_of(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 30, "sightings")
            cell.plant.plant("belt").inject("belt-reverse", {"for_s": 2.0})
            assert (await cell.finished(run_id))["verdict"] == "warn"
            assert "belt.both-ways" in [w["code"] for w in answer(cell, run_id)["warnings"]]

    run_virtual(scene())


def test_a_counter_that_is_set_meanwhile_does_not_turn_its_way_round(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path, {"m_per_count": "1.013e-4"}) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 30, "sightings")
            encoder = cell.plant.encoder.encoder
            now = cell.clock.now()
            encoder.preset(now, encoder.position(now) - 30000)
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert_true(cell, answer(cell, run_id))

    run_virtual(scene())


def test_finished_early_it_solves_what_it_has_and_says_so(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 30, "sightings")
            await cell.engine.finish("test")
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            result = answer(cell, run_id)
            assert "belt.finished-early" in [w["code"] for w in result["warnings"]]
            assert_true(cell, result)

    run_virtual(scene())


def test_touches_before_and_after_a_lost_encoder_are_never_compared(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            teacher = Teacher(cell)
            run_id = await cell.start(params=TOUCH)
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
            await teacher.touch()
            cell.plant.plant("belt").inject("drop")
            await cell.until(cell.all_ready, "ready devices", 120.0)
            await teacher.touch()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "DEVICE_LOST")
            assert "began to count anew" in end["error"]["text"]
            assert len((cell.folder(run_id).path / "counts.jsonl").read_text("utf-8").splitlines()) > 100

    run_virtual(scene())


def test_touches_before_and_after_a_jump_of_the_count_are_never_compared(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            teacher = Teacher(cell)
            run_id = await cell.start(params=TOUCH)
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
            await teacher.touch()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step == 1, "the first touch")
            cell.plant.plant("belt").inject("wrap", {"before": 30000})
            await teacher.touch()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "ENCODER_JUMP")

    run_virtual(scene())


@pytest.mark.parametrize(
    ("device", "kind", "name"),
    [
        ("belt", "silence", "DEVICE_LOST"),
        ("belt", "bus-off", "CAN_BUS_OFF"),
        ("camera", "silence", "DEVICE_LOST"),
    ],
)
def test_a_fault_while_items_go_by_ends_the_job_by_name_and_the_next_one_succeeds(
    tmp_path: Path, device: str, kind: str, name: str
) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 10, "sightings")
            cell.plant.plant(device).inject(kind)
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", name)
            assert cell.at_rest()
            assert not [r for r in cell.ledger.results() if r["name"] == "belt.belt"]
            cell.plant.plant(device).clear()
            await cell.until(cell.all_ready, "ready devices", 120.0)
            await cell.engine.reset("test")
            run_id = await cell.start()
            assert (await cell.finished(run_id))["verdict"] == "pass"

    run_virtual(scene())


def test_a_camera_that_drops_and_comes_back_costs_neither_the_run_nor_its_truth(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 10, "sightings")
            cell.plant.plant("camera").inject("drop")
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete", end["error"]
            result = answer(cell, run_id)
            (told,) = [e for e in cell.journal(run_id) if e.get("event") == "lost and back"]
            assert (told["kind"], told["name"]) == ("device", "DEVICE_LOST")
            assert_true(cell, result)

    run_virtual(scene())


def test_an_encoder_that_drops_and_counts_anew_parts_the_items_and_the_answer_is_as_true(
    tmp_path: Path,
) -> None:
    async def scene() -> tuple[Any, Any, Any]:
        async with belt_cell(tmp_path) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 10, "sightings")
            cell.plant.plant("belt").inject("drop")
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete", end["error"]
            assert len(cell.notes(run_id, "counts begin anew")) == 1
            data = read_json(cell.folder(run_id).path / "belt.json")
            (begun,) = data["begins"]
            (before, after) = (
                np.array([n for t, n in data["encoder"] if (t >= begun) == k]) for k in (False, True)
            )
            assert before[-1] - after[0] > 500, "the counter began at another place"
            assert_true(cell, answer(cell, run_id))
            return data, read_json(cell.folder(run_id).path / "run.json")["job_config"], cell.result(run_id)

    data, config, result = run_virtual(scene())
    data["begins"] = []
    write_atomic(tmp_path / "belt.json", to_json(data))
    wrong = solve_belt(tmp_path / "belt.json", config)
    assert wrong["result"] != result["result"], "the time of the new count matters"


def test_an_arm_that_says_nothing_at_a_touch_ends_the_job_by_name(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            teacher = Teacher(cell)
            run_id = await cell.start(params=TOUCH)
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
            cell.plant.plant("arm").inject("silence")
            await teacher.touch()
            end = await cell.finished(run_id)
            assert end["outcome"] == "aborted"
            assert end["error"]["name"] in ("STALE_DATA", "DEVICE_NOT_READY", "DEVICE_LOST")

    run_virtual(scene())


@pytest.mark.parametrize("way", ["abort", "halt"])
def test_a_stop_ends_it_and_the_camera_looks_for_items_no_more(tmp_path: Path, way: str) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.step > 10, "sightings")
            await getattr(cell.engine, way)("test")
            end = await cell.finished(run_id)
            assert end["outcome"] == {"abort": "stopped", "halt": "halted"}[way]
            await cell.clock.sleep(1.0)
            last = cell.supervisor.devices["camera"].device.frames.last()
            assert last.value.items is None

    run_virtual(scene())


def test_without_a_calibrated_camera_it_is_refused(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            await cell.engine.decisions.rollback("T_base_camera", "test")
            assert (await refused(cell.start())).name == "BELT_NO_CAMERA"

    run_virtual(scene())


@pytest.mark.parametrize("touches", [2, 3, 4])
def test_a_mark_touched_before_and_after_the_belt_moved_gives_scale_and_direction(
    tmp_path: Path, touches: int
) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path, {"m_per_count": "1.013e-4", "dir": "[0.998, 0.05, 0.0]"}) as cell:
            teacher = Teacher(cell)
            limits = {"max_scale_share": 0.01, "max_dir_rad": 0.01}
            run_id = await cell.start(params={**TOUCH, "touches": touches, "accept": limits})
            for _ in range(touches):
                await teacher.touch()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            result = answer(cell, run_id)
            assert result["verdict"] in ("pass", "warn"), result["reasons"]
            assert_true(cell, result)
            assert "the same mark" not in teacher.asked[0]
            assert "the same mark" in teacher.asked[1]

    run_virtual(scene())


def test_a_touch_on_a_belt_that_still_moves_is_asked_for_again(tmp_path: Path) -> None:
    async def scene() -> None:
        async with belt_cell(tmp_path) as cell:
            teacher = Teacher(cell)
            run_id = await cell.start(params=TOUCH)
            await teacher.touch(creep_m_s=0.02)
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
            await teacher.touch()
            assert teacher.asked[1].startswith("The belt still moved")
            await cell.engine.finish("test")
            await cell.finished(run_id)
            assert answer(cell, run_id)["reasons"][0].startswith("too-few-touches:")

    run_virtual(scene())


def test_items_are_told_apart_by_where_the_counts_carry_them() -> None:
    follower = ItemFollower(np.array([1e-4, 0.0, 0.0]))
    for k in range(12):  # each frame the belt moves by most of the items' spacing
        places = np.arange(5)[:, None] * [-0.1, 0.0, 0.0] + [0.08 * k, 0.0, 0.0]
        follower.add(0.1 * k, 800.0 * k, places[(places[:, 0] > -0.2) & (places[:, 0] < 0.3)])
    rows = follower.rows()
    for number in range(5):
        own = rows.items == number
        assert np.ptp(rows.points[own, 0] - 1e-4 * rows.counts[own]) < 1e-9
    assert len(set(rows.items)) == 5
