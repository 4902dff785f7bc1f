"""What a person sees of a sampling: expectations in ``check``, the plan of a dry run, the report of a run."""

from pathlib import Path
from typing import Any

import pytest

from daemon.config import ConfigInvalid
from daemon.predictions import predictions
from daemon.words.plan_text import plan_text
from daemon.words.result_text import result_text
from fakes.object import run_virtual
from procedures.report.write import write_report
from tests.kit.object_cell import no_report, open_cell
from tests.kit.tracker_cell import JOB, tracker_config

__all__ = ["no_report"]


def expected(
    folder: Path, job: dict[str, Any] | None = None, scenario: str = "tracker:ideal"
) -> dict[str, Any]:
    (found,) = (p for p in predictions(tracker_config(folder, job, scenario=scenario)) if p["job"] == JOB)
    return found


@pytest.mark.parametrize(("scenario", "rank"), [("tracker", 21), ("palletizer", 11)])
def test_check_says_how_well_the_poses_will_tell_the_arm(tmp_path: Path, scenario: str, rank: int) -> None:
    found = expected(tmp_path, scenario=scenario)
    assert found["problems"] == []
    assert (found["poses"], found["rank"]) == (12, rank)
    assert 1e-5 < found["predicted"]["rms_m"] < found["predicted"]["error_95_max_m"] < 1e-3
    assert "12 of 12 poses are reached and seen, 2 of them are set aside" in found["text"]
    assert f"rank {rank} of {rank} possible" in found["text"]
    assert "is not kept: 10 poses," in found["text"]


def test_check_says_what_the_rule_of_thumb_costs_where_some_poses_have_to_give_way_to_it(
    tmp_path: Path,
) -> None:
    """More than half of the poses that tell most of a palletizer have joint 2 at one end of its range."""
    job = {"poses": 62, "held_out_share": 0.2}
    free = expected(tmp_path, job, scenario="palletizer:ideal")
    kept = expected(tmp_path, {**job, "keep_rule": True}, scenario="palletizer:ideal")
    assert not free["source_rule"]["kept"]
    assert kept["source_rule"] | {"smallest_step_rad": 0.0} == {
        **free["source_rule"], "kept": True, "short_steps": 0, "smallest_step_rad": 0.0,
    }  # fmt: skip
    assert 1.0 <= kept["predicted"]["rms_m"] / free["predicted"]["rms_m"] < 1.05
    assert 1.0 < kept["by_rule"]["travel_rad"] / kept["by_rule"]["shortest_rad"] < 3.0
    assert "is kept by their order: joints turn" in kept["text"], "how fast it moves is not known here"


def test_check_names_what_keeps_the_job_from_succeeding(tmp_path: Path) -> None:
    still = [[-2, 2], [-2.2, -0.8], [1.8, 1.8], [-2, 2], [-2, 2], [-2, 2]]
    (problem,) = expected(tmp_path, {"joint_ranges_rad": still})["problems"]
    assert "joint 3 does not move" in problem
    (problem,) = expected(tmp_path, {"payload_kg": 5.0})["problems"]
    assert "5 kg" in problem


def test_check_names_a_reflector_that_the_trackers_section_lacks(tmp_path: Path) -> None:
    config = tracker_config(tmp_path)
    device = config.robot.roles()["tracker"]
    section = config.device[device].model_copy(update={"reflectors": {"smr1": None, "m1": None}})
    config = config.model_copy(update={"device": {**config.device, device: section}})
    (found,) = (p for p in predictions(config) if p["job"] == JOB)
    (problem,) = found["problems"]
    assert f"[device.{device}] reflectors has smr1, m1, but not 'm2'" in problem


def test_check_warns_of_a_stand_that_nothing_watches_and_of_a_limit_that_will_be_missed(
    tmp_path: Path,
) -> None:
    cautions = expected(tmp_path, {"monuments": {}, "accept": {"max_error_m": 0.00001}})["cautions"]
    assert any("max_error_m is 0.01" in text for text in cautions)
    assert any("without monuments" in text for text in cautions)


@pytest.mark.parametrize(
    ("job", "told"),
    [
        ({"arm": "observed_arm"}, "joint_ranges_rad is missing"),
        ({"monuments": {"smr1": {"point": [0, 0, 0]}}}, "'smr1' is a reflector and a monument"),
        ({"sight": {"range_m": [5.0, 1.0]}}, "5 is not below 1"),
        ({"reflectors": {"smr1": {"point": [0, 0, 0], "normal": [0, 0, 0]}}}, "normal has no length"),
        ({"pose": 12}, "poses"),
        (
            {"reflectors": {"smr1": {"point": [0, 0, 0]}, "smr2": {"point": [0.03, 0, 0]}}},
            "'smr1' and 'smr2' are 30 mm apart",
        ),
    ],
)
def test_a_section_that_cannot_be_right_is_told_with_the_fix(
    tmp_path: Path, job: dict[str, Any], told: str
) -> None:
    with pytest.raises(ConfigInvalid, match=told):
        tracker_config(tmp_path, job)


@pytest.mark.usefixtures("no_report")
def test_a_dry_run_shows_every_pose_with_its_margins_and_what_stays_open(tmp_path: Path) -> None:
    async def main() -> str:
        async with open_cell(tracker_config(tmp_path), job=JOB) as cell:
            shown = await cell.dry_run()
            return plan_text(shown["plan"])

    text = run_virtual(main())
    assert "4 poses come first, to find the tracker's place:" in text
    assert "12 poses in their order" in text
    assert text.count("check") >= 2
    assert "stays open:" in text
    assert text.endswith("Nothing was moved.")


@pytest.mark.usefixtures("no_report")
def test_a_run_by_the_rule_of_thumb_has_kept_it_when_it_is_solved(tmp_path: Path) -> None:
    job = {"poses": 62, "held_out_share": 0.2, "keep_rule": True}

    async def main() -> dict[str, Any]:
        async with open_cell(tracker_config(tmp_path, job, scenario="palletizer:ideal"), job=JOB) as cell:
            await cell.run_job()
            return cell.result(1)

    result = run_virtual(main())
    rule = result["observability"]["source_rule"]
    assert (result["verdict"], rule["kept"], rule["samples"]) == ("pass", True, 50)


@pytest.mark.usefixtures("no_report")
def test_a_run_is_told_in_words_and_drawn(tmp_path: Path) -> None:
    async def main() -> tuple[dict[str, Any], Path]:
        async with open_cell(
            tracker_config(tmp_path, {"poses": 20}, scenario="palletizer:ideal"), job=JOB
        ) as cell:
            await cell.run_job()
            return cell.result(1), cell.folder(1).path

    result, folder = run_virtual(main())
    text = result_text(result)
    assert "4 poses were set aside before solving: nominal" in text
    assert "monuments moved by" in text
    write_report(folder)
    page = (folder / "report.html").read_text("utf-8")
    assert "set aside" in page
    assert "m1" in page
