"""Poses of an earlier run solved with a run's own: only of the same arm, load and stand of the tracker."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cell.errors import CellError
from cell.store.files import read_json
from daemon.cli.replay import differences
from fakes.object import run_virtual
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import robot_of
from procedures.tracker.stored import load_stored
from tests.kit.object_cell import no_report, open_cell
from tests.kit.solved import solve_again
from tests.kit.tracker_cell import JOB, monuments, reflectors, rms, tracker_config, true_errors
from tests.unit.procedures.test_tracker_sampling_plan import values

__all__ = ["no_report"]
EARLIER, TODAY = 18, 8
SECTION = {"reflectors": reflectors("tracker", "smr1"), "monuments": monuments("tracker")}


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of a whole run."""
    config = tracker_config(tmp_path_factory.mktemp("earlier"), {"poses": EARLIER})

    async def main() -> Path:
        async with open_cell(config, job=JOB) as cell:
            assert (await cell.run_job())["outcome"] == "complete"
            return cell.folder(1).path / "kincal.json"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("daemon.results._write_report", _drawn)
        return run_virtual(main())


async def _drawn(run: Any) -> None: ...


def changed(earlier: Path, folder: Path, **keys: Any) -> Path:
    path = folder / "set.json"
    path.write_text(json.dumps(read_json(earlier) | keys))
    return path


def job(path: Path) -> TrackerSamplingConfig:
    return TrackerSamplingConfig.model_validate({**SECTION, "with_set": str(path)})


@pytest.mark.usefixtures("no_report")
def test_few_poses_with_a_stored_set_reach_what_many_reach(earlier: Path, tmp_path: Path) -> None:
    limits = {"max_predicted_m": 0.0003, "accept": {"max_error_m": 0.0003}}
    config = tracker_config(tmp_path, {"poses": TODAY, "with_set": str(earlier), **limits})

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end
            result, folder = cell.result(1), cell.folder(1)
            stored = len(read_json(earlier)["samples"])
            aside = round(0.2 * TODAY)
            data = read_json(folder.path / "kincal.json")
            assert len(data["samples"]) == stored + TODAY - aside
            assert len({s["index"] for s in data["samples"]}) == len(data["samples"])
            facts = result["inputs"]["sampling"]
            assert (facts["measured"], facts["stored"]["samples"]) == (TODAY, stored)
            assert len(read_json(folder.path / "heldout.json")["samples"]) == aside
            again = solve_again(JOB, folder.path, read_json(folder.path / "run.json"), result)
            assert differences(result, again) == []
            Q = np.array([s["q"] for s in data["samples"]])
            elsewhere = np.random.default_rng(8).uniform(Q.min(axis=0), Q.max(axis=0), (100, 6))
            assert rms(true_errors(cell.plant.world, result, elsewhere)) <= 0.00006

    run_virtual(main())


@pytest.mark.parametrize("role", ["arm", "tracker"])
def test_a_set_of_another_arm_or_tracker_is_refused_in_one_sentence(earlier: Path, role: str) -> None:
    data = read_json(earlier)
    stored = load_stored(str(earlier), job(earlier), data["robot"], data["payload_kg"])
    assert stored is not None
    serials = data["notes"]["sampling"]["serials"]
    stored.require_same_devices(serials)
    stored.require_same_devices({role: ""})
    with pytest.raises(CellError) as caught:
        stored.require_same_devices(serials | {role: "20991234"})
    assert caught.value.name == "TRACKER_SET_REFUSED"
    assert f"it was measured with {role} {serials[role]}, and this is {role} 20991234" in caught.value.detail


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize(("shift", "name"), [(0.002, "TRACKER_MOVED"), (None, "TRACKER_SET_REFUSED")])
def test_a_set_from_another_stand_is_refused_by_the_monuments(
    earlier: Path, tmp_path: Path, shift: float | None, name: str
) -> None:
    notes = read_json(earlier)["notes"]
    points = notes["sampling"]["monument_points"]
    for key in list(points):
        points[key]["p_tracker"][0] += shift or 0.0
        if shift is None and key > "m1":
            del points[key]
    path = changed(earlier, tmp_path, notes=notes)
    config = tracker_config(tmp_path, {"poses": TODAY, "with_set": str(path)})

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["error"]["name"]) == ("aborted", name), end
            assert str(path) in end["error"]["text"]
            assert cell.at_rest()

    run_virtual(main())


def test_a_set_of_another_arm_load_or_reflector_is_refused_with_the_reason(
    earlier: Path, tmp_path: Path
) -> None:
    robot = robot_of(values(), job(earlier))
    stored = load_stored(str(earlier), job(earlier), robot, 0.8)
    assert stored is not None
    assert len(stored.entries()) == len(read_json(earlier)["samples"])
    samples = read_json(earlier)["samples"]
    samples[3]["target"] = "smr9"
    for keys, said in (
        ({"robot": {**robot, "model": "ur5e"}}, "robot"),
        ({"robot": {**robot, "tool": {"smr1": [0.0, 0.0, 0.1]}}}, "reflector"),
        ({"payload_kg": 2.0}, "payload_kg is 2.0, and here it is 0.8"),
        ({"payload_kg": None}, "payload_kg"),
        ({"samples": samples}, "smr9"),
    ):
        path = changed(earlier, tmp_path, **keys)
        with pytest.raises(CellError, match=said) as caught:
            load_stored(str(path), job(path), robot, 0.8)
        assert caught.value.name == "TRACKER_SET_REFUSED"
    with pytest.raises(CellError, match="nowhere"):
        load_stored(str(tmp_path / "nowhere.json"), job(earlier), robot, 0.8)


@pytest.mark.parametrize(
    ("keys", "said"), [({"with_set": "set.json"}, "full path"), ({"monuments": {}}, "needs 3 monuments")]
)
def test_a_set_needs_a_full_path_and_monuments(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        TrackerSamplingConfig.model_validate({**SECTION, "with_set": "/data/set.json", **keys})
