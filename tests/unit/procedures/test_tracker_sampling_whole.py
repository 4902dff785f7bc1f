"""The whole sampling on virtual time, of an arm that is moved and of one that is read, against the truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.calibrations import kinematics
from cell.errors import CellError
from cell.formats.kincal import SCHEMA
from cell.store.files import read_json
from daemon.cli.replay import differences
from daemon.stored_result import summary_of
from daemon.words.value_text import value_text
from fakes.object import run_virtual
from procedures.comparison import compare_results
from tests.kit.object_cell import ObjectCell, open_cell
from tests.kit.solved import solve_again
from tests.kit.tracker_cell import JOB, rms, tracker_config, true_errors

SCENARIOS = ("tracker", "palletizer")
POSES = {"tracker": 44, "palletizer": 36}
DEVICE = {"tracker": "arm", "palletizer": "palletizer"}
BEFORE_M = {"tracker": (0.0015, 0.003), "palletizer": (0.003, 0.0045)}
AFTER_M = 0.00005
GOOD = {"max_predicted_m": 0.0003, "accept": {"max_error_m": 0.0003, "auto": True}}


@dataclass
class Done:
    """A finished run and the cell that it ran in."""

    scenario: str
    cell: ObjectCell
    end: dict[str, Any]
    result: dict[str, Any]
    ledger: list[dict[str, Any]]
    trends: dict[str, list[Any]]

    @property
    def folder(self) -> Path:
        return self.cell.folder(1).path


@pytest.fixture(scope="module", params=SCENARIOS)
def done(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Done]:
    """One run of each kind, which the tests look at from all sides."""
    patch = pytest.MonkeyPatch()

    async def drawn(run: Any) -> None: ...

    patch.setattr("daemon.results._write_report", drawn)
    name = request.param
    config = tracker_config(tmp_path_factory.mktemp(name), {"poses": POSES[name], **GOOD}, scenario=name)

    async def main() -> Done:
        async with open_cell(config, job=JOB) as cell:
            end = await cell.run_job()
            rows = cell.ledger.results(kinematics(DEVICE[name]))
            await cell.engine.decisions.rollback(kinematics(DEVICE[name]), "test")
            assert cell.ledger.effective(kinematics(DEVICE[name]), None).version is None
            trends = {n: cell.ledger.trend(n, 5) for n in cell.result(1)["inputs"].get("trend", {})}
            return Done(name, cell, end, cell.result(1), rows, trends)

    yield run_virtual(main())
    patch.undo()


def elsewhere(done: Done) -> Any:
    """Joints all over the ranges that were sampled, none of them measured."""
    Q = np.array([s["q"] for s in read_json(done.folder / "kincal.json")["samples"]])
    return np.random.default_rng(8).uniform(Q.min(axis=0), Q.max(axis=0), (150, Q.shape[1]))


def test_predictions_come_from_millimetres_to_fifty_micrometres_of_the_truth(done: Done) -> None:
    assert (done.end["outcome"], done.end["verdict"]) == ("complete", "pass"), done.result["reasons"]
    low, high = BEFORE_M[done.scenario]
    assert low < done.result["result"]["absolute_accuracy"]["before"] < high
    assert rms(true_errors(done.cell.plant.world, done.result, elsewhere(done))) <= AFTER_M


def test_the_promised_error_holds_all_over_the_sampled_ranges(done: Done) -> None:
    off = true_errors(done.cell.plant.world, done.result, elsewhere(done))
    assert np.mean(off < done.result["uncertainty"]["predicted_95"]["workspace"]["max"]) > 0.9
    promised = done.result["inputs"]["sampling"]["predicted"]["rms_m"]
    assert rms(off) < 2.0 * promised


def test_poses_that_were_set_aside_judge_the_result_and_did_not_make_it(done: Done) -> None:
    solved, aside = (read_json(done.folder / f"{name}.json") for name in ("kincal", "heldout"))
    held = round(0.2 * POSES[done.scenario])
    assert (len(solved["samples"]), len(aside["samples"])) == (POSES[done.scenario] - held, held)
    assert solved["schema"] == aside["schema"] == SCHEMA
    assert not {s["index"] for s in solved["samples"]} & {s["index"] for s in aside["samples"]}
    found = done.result["heldout"]["set_aside"]
    assert found["samples"] == held
    assert found["rms"]["calibrated"] < 0.05 * found["rms"]["registration_only"]
    assert found["rms"]["calibrated"] < 2.0 * found["tracker_3d"]


def test_payload_robot_and_noise_are_in_the_data(done: Done) -> None:
    data = read_json(done.folder / "kincal.json")
    assert data["payload_kg"] == {"tracker": 0.8, "palletizer": 40.0}[done.scenario]
    assert data["noise"] == {"sigma0": 15e-6, "sigma_per_m": 6e-6, "sigma_constant": 1e-5}
    assert done.result["result"]["payload_kg"] == data["payload_kg"]


def test_the_monuments_are_looked_at_every_ten_poses_and_at_the_end(done: Done) -> None:
    looked = done.result["inputs"]["sampling"]["monuments"]
    assert [look["after"] for look in looked["looks"]] == [
        *range(10, POSES[done.scenario], 10),
        POSES[done.scenario],
    ]
    assert looked["max_moved_m"] < looked["limit_m"]
    assert not looked["beyond_noise"]


def test_the_accepted_arm_was_in_effect_until_it_was_rolled_back_and_is_told_in_a_line(done: Done) -> None:
    (row,) = done.ledger
    assert row["state"] == "committed"
    value = row["value"]
    assert value["robot"] == done.result["result"]["robot"]
    assert value["serials"].keys() == {"arm", "tracker"}
    assert all(serial.startswith("9999") for serial in value["serials"].values())
    assert value["payload_kg"] == done.result["result"]["payload_kg"]
    assert value["rms_calibrated"] < 0.0001 < value["rms_registration_only"]
    assert "calibrated arm" in value_text(row["name"], value)


def test_a_replay_gives_the_same_answer(done: Done) -> None:
    info = read_json(done.folder / "run.json")
    again = solve_again(JOB, done.folder, info, done.result)
    assert differences(done.result, again) == []


def test_health_numbers_are_kept(done: Done) -> None:
    assert set(done.trends) >= {f"kinematics.rms_after_m.{DEVICE[done.scenario]}", "tracker.drift_m.tracker"}
    assert all(len(points) == 1 for points in done.trends.values())


def test_a_status_page_gets_the_figures_without_their_tables(done: Done) -> None:
    shown = summary_of(done.result)
    assert shown is not None
    assert shown["result"]["absolute_accuracy"] == done.result["result"]["absolute_accuracy"]
    assert len(str(shown)) < 20_000


def test_runs_with_different_payloads_are_not_compared(done: Done) -> None:
    same = compare_results(done.result, {**done.result, "reasons": ["solved again"]})
    assert "within what their uncertainties explain" in same.text("run 1", "run 2")
    other = {**done.result, "inputs": {**done.result["inputs"], "payload_kg": 2.5}}
    with pytest.raises(CellError, match=r"2\.5 kg") as caught:
        compare_results(done.result, other)
    assert caught.value.name == "PAYLOAD_DIFFERS"


def test_an_arm_that_changed_is_told_by_a_comparison(done: Done) -> None:
    robot = done.result["result"]["robot"]
    key = "links" if "links" in robot else "parameters"
    if key == "links":
        links = [dict(link) for link in robot["links"]]
        links[2]["a"] += 0.0004
        changed = {**robot, "links": links}
    else:
        changed = {**robot, "parameters": {**robot["parameters"], "a3": robot["parameters"]["a3"] + 0.0004}}
    other = {**done.result, "result": {**done.result["result"], "robot": changed}}
    found = compare_results(done.result, other)
    assert found.significant
    assert 0.00005 < found.as_dict()["rms_m"] < 0.0004
