"""Short silences while something is measured: the run completes with its answer and tells of each."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.poses import from_pose6
from cell.store.files import read_json
from fakes.object import run_virtual
from tests.kit.interrupted import Struck, run_struck, silence_at
from tests.kit.laser_cell import laser_cell, laser_config
from tests.kit.laser_made import Solved, drawn_reference, solved
from tests.kit.object_cell import no_report, open_cell
from tests.kit.tracker_cell import tracker_config
from tests.unit.procedures.test_iso9283_job import POINT, iso_config, true_reflector
from tests.unit.procedures.test_latency_job import cell_config, with_reference

__all__ = ["no_report", "solved"]
pytestmark = pytest.mark.usefixtures("no_report")

SHORT, LONGER = 0.3, 1.5
AUTO = {"accept": {"auto": True}}
FEW = {"poses": 10, "held_out_share": 0.0, "monument_every": 5, "accept": {"max_error_m": 0.1}}
ISO = {"cycles": 2, "find_timeout_s": 0.5, "measure_timeout_s": 1.0}
ON_THE_WAY_S = 0.05


def strike_all(subject: Struck, strikes: list[tuple[str, str, float]]) -> None:
    for device, moment, duration_s in strikes:
        silence_at(subject, device, moment, duration_s, ON_THE_WAY_S)


@pytest.mark.parametrize(
    ("job", "strikes"),
    [
        (
            "laser-reference",
            [("arm", "plan", SHORT), ("beams", "sweep", LONGER), ("arm", "bisect", SHORT)],
        ),
        (
            "laser-check",
            [("arm", "approach", SHORT), ("beams", "descend", LONGER), ("arm", "retract", SHORT)],
        ),
        ("laser-update", [("arm", "sweep", SHORT), ("beams", "verify", SHORT), ("arm", "compare", SHORT)]),
    ],
)
def test_silences_at_the_beams_cost_steps_and_the_same_passes_are_taken(
    job: str, strikes: list[tuple[str, str, float]], tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path, update=AUTO)
    reference = None if job == "laser-reference" else drawn_reference(config)

    async def main() -> None:
        async with laser_cell(config, job, reference) as cell:
            subject = Struck(cell)
            strike_all(subject, strikes)
            await run_struck(subject)
            assert sorted(subject.at) == sorted(moment for _, moment, _ in strikes)
            subject.tells_the_same_everywhere()
            assert subject.taken_again
            data = read_json(cell.folder(1).path / "laser.json")
            used = data["current" if reference else "reference"]["passes"]
            measured = [p for p in used if p["notes"]["phase"] == "measure"]
            places = {(p["beam"], p["notes"]["place"]) for p in measured}
            assert len(measured) >= 2 * len(places) > 0
            for way in measured:
                assert np.max(np.diff(way["pose_t"])) < 0.05, "a way across a gap was used"
                assert np.max(np.diff(way["poll_t"])) < 0.05, "a way across a gap was used"

    run_virtual(main())


def gap_nobody_noticed(cell: Any, times: int) -> list[float]:
    """The arm gave no state for a moment on the way back of the next ``times`` pairs; when that ended."""
    ended: list[float] = []

    def strike() -> None:
        now = cell.clock.now()
        cell.engine.running.arm().state.last_gap = now - 0.15, now
        ended.append(now)

    cell.at_state("return", strike, ON_THE_WAY_S, times)
    return ended


def test_a_pair_of_passes_that_a_gap_touched_is_recorded_only_when_it_was_taken_again(
    tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-reference") as cell:
            ended = gap_nobody_noticed(cell, times=2)
            assert (await cell.run_job())["outcome"] == "complete"
            assert len(ended) == len(cell.notes(1, "step taken again")) == 2
            passes = read_json(cell.folder(1).path / "laser.json")["reference"]["passes"]
            lines = (cell.folder(1).path / "passes.jsonl").read_text().splitlines()
            assert sum(json.loads(line)["used"] for line in lines) == len(passes) > 0
            for way in passes:
                assert not any(way["pose_t"][0] < t <= way["pose_t"][-1] for t in ended)

    run_virtual(main())


def test_a_pose_that_is_given_up_in_an_interrupted_step_counts_once(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(
            tracker_config(tmp_path, FEW | {"retries_per_pose": 0}), job="tracker-sampling"
        ) as cell:
            struck, seen = False, 0

            def look() -> None:
                nonlocal struck, seen
                run = cell.engine.running
                if struck or run is None or len(run.visited) == seen:
                    return
                seen = len(run.visited)
                if run.state != "measure" or run.step != 3:
                    return
                struck = True
                now = cell.clock.now()
                run.arm().state.last_gap = now - 0.15, now  # nobody noticed, until the step has ended
                cell.plant.plants["tracker"].inject("out-of-view", {"duration_s": 2.6})

            cell.engine.subscribe(look)
            assert (await cell.run_job())["outcome"] == "complete"
            samples = read_json(cell.folder(1).path / "kincal.json")["samples"]
            assert len(cell.notes(1, "step taken again")) == 1
            assert len(samples) == FEW["poses"]
            Q = np.array([sample["q"] for sample in samples])
            apart = np.max(np.abs(Q[:, None] - Q), axis=2) + np.eye(len(Q))
            assert np.min(apart) > 0.01, "a pose was measured twice"
            assert cell.notes(1, "pose failed")
            assert not cell.notes(1, "pose skipped"), "of the step that was taken again, nothing is told"

    run_virtual(main())


@pytest.mark.parametrize(
    "strikes",
    [
        [("arm", "sweep", SHORT), ("beams", "return", LONGER)],
        [("arm", "approach", LONGER), ("beams", "sweep", SHORT), ("arm", "lift", SHORT)],
    ],
)
def test_the_delay_of_the_beams_is_the_true_one_in_spite_of_silences(
    strikes: list[tuple[str, str, float]], tmp_path: Path
) -> None:
    config = cell_config(tmp_path, passes=3)

    async def main() -> None:
        async with open_cell(config, job="latency-calibration") as cell:
            with_reference(cell)
            subject = Struck(cell)
            strike_all(subject, strikes)
            await run_struck(subject)
            subject.tells_the_same_everywhere()
            assert subject.taken_again
            answer = cell.result(1)["result"]
            low, high = answer["interval95_s"]
            assert abs(answer["time_offset_s"] - cell.plant.world.config.beams["xs"].latency_s) < high - low

    run_virtual(main())


@pytest.mark.parametrize(
    ("scenario", "strikes"),
    [
        ("tracker", [("arm", "plan", LONGER), ("tracker", "monuments", SHORT), ("arm", "move", SHORT)]),
        (
            "tracker",
            [("tracker", "plan", SHORT), ("tracker", "measure", LONGER), ("arm", "locate", SHORT)],
        ),
        ("palletizer", [("palletizer", "request", SHORT), ("tracker", "monuments", LONGER)]),
        ("palletizer", [("palletizer", "plan", LONGER), ("palletizer", "measure", SHORT)]),
    ],
)
def test_a_sampling_keeps_every_pose_in_spite_of_silences(
    scenario: str, strikes: list[tuple[str, str, float]], tmp_path: Path
) -> None:
    async def main() -> None:
        async with open_cell(
            tracker_config(tmp_path, FEW, scenario=f"{scenario}:ideal"), job="tracker-sampling"
        ) as cell:
            subject = Struck(cell)
            strike_all(subject, strikes)
            await run_struck(subject)
            subject.tells_the_same_everywhere()
            assert subject.taken_again
            samples = read_json(cell.folder(1).path / "kincal.json")["samples"]
            assert len(samples) == FEW["poses"]
            tracker = cell.plant.world.tracker
            assert tracker is not None
            stand = tracker.stand.at(cell.plant.world.t0)
            for sample in samples:  # the reflector was seen where the arm truly had it at those joints
                seen = stand.apply(np.array(sample["p_tracker"]))
                assert np.linalg.norm(seen - true_place(cell, scenario, sample)) < 2e-4

    run_virtual(main())


def true_place(cell: Any, scenario: str, sample: dict[str, Any]) -> Any:
    world = cell.plant.world
    truth = world.config.reflectors[sample["target"]]
    q = np.array(sample["q"])
    flange = world.true.forward(q) if scenario == "tracker" else world.observed.true.flange(q)
    return flange.apply(truth.point)


@pytest.mark.parametrize(
    "strikes",
    [
        [("arm", "plan", SHORT), ("tracker", "measure", LONGER), ("arm", "settle", SHORT)],
        [("tracker", "plan", LONGER), ("arm", "move", LONGER), ("arm", "measure", SHORT)],
    ],
)
def test_the_poses_reached_are_the_true_ones_in_spite_of_silences(
    strikes: list[tuple[str, str, float]], tmp_path: Path
) -> None:
    async def main() -> None:
        # Seen that often, a step ends between two strikes, so that they are not three in a row.
        often = {"state_period_s": 0.01}
        async with open_cell(iso_config(tmp_path, ISO, arm_keys=often), job="iso9283") as cell:
            subject = Struck(cell)
            strike_all(subject, strikes)
            await run_struck(subject)
            subject.tells_the_same_everywhere()
            assert subject.taken_again
            data = read_json(cell.folder(1).path / "iso9283.json")
            assert len(data["samples"]) == 4 + 5 * ISO["cycles"]
            stand = from_pose6(cell.plant.world.config.tracker.T_base_tracker)
            assert POINT.shape == (3,)
            at = {pose["name"]: true_reflector(cell, pose["q"]) for pose in data["poses"]}
            for sample in data["samples"]:
                assert np.linalg.norm(stand.apply(np.array(sample["p_tracker"])) - at[sample["pose"]]) < 2e-4

    run_virtual(main())
