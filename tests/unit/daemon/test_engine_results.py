"""From a solved run to a committed calibration: limits, acceptance, conflicts, replay."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import daemon.results
from cell.formats.result import Result
from daemon.cli.replay import differences
from fakes.object import run_virtual
from procedures.hand_eye.config import Acceptance
from procedures.hand_eye.verdict import judged, solve_within_limits
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell, refused, write_config
from tests.kit.whole_results import made

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

NAME = "T_flange_camera"
GENUINE_REPORT = daemon.results._write_report


WIDE = Acceptance(max_error_t_m=0.1, max_error_r_rad=0.1)


def with_cov(cov: list[list[float]] | None) -> Any:
    """A result that is good but for its covariance."""
    parts = {"result": {"cov": cov}, "uncertainty": {"cov": cov}}
    return made({"kind": "hand-eye", "verdict": "pass", "reasons": [], **parts})


def only_result(cell: ObjectCell) -> dict[str, Any]:
    (result,) = cell.ledger.results()
    return result


def test_a_passing_result_is_proposed_and_waits_for_a_person(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            await cell.run_job()
            proposed = only_result(cell)
            assert (proposed["name"], proposed["state"], proposed["run_id"]) == (NAME, "proposed", 1)
            assert proposed["value"] == cell.result(1)["result"][NAME]
            committed = await cell.engine.decisions.accept(proposed["id"], WHO)
            assert (committed["state"], committed["version"]) == ("committed", 1)

    run_virtual(main())


def test_the_policy_commits_a_passing_result_and_the_next_run_uses_it(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"accept": {"auto": True}})) as cell:
            await cell.run_job()
            first = only_result(cell)
            assert (first["state"], first["who"]) == ("committed", "policy")
            run_id = await cell.start()
            values = cell.folder(run_id).info["values"]
            assert values["calibration"]["eye-in-hand"]["X"] == first["value"]
            assert values["versions"] == {NAME: 1}
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert [r["state"] for r in cell.ledger.results()] == ["committed", "superseded"]

    run_virtual(main())


@pytest.mark.parametrize("limit", ["max_error_t_m", "max_error_r_rad"])
def test_a_result_beyond_a_limit_fails_stays_filled_and_is_not_proposed(limit: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"accept": {limit: 1e-6, "auto": True}})) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            result = cell.result(1)
            assert len(result["result"][NAME]) == 6
            assert [reason.split(":")[0] for reason in result["reasons"]] == [limit]
            assert cell.ledger.results() == []

    run_virtual(main())


def test_the_95_percent_errors_agree_with_a_monte_carlo_of_the_covariance() -> None:
    rng = np.random.default_rng(7)
    A = rng.normal(size=(6, 6))
    cov = A @ A.T * 1e-8
    found = judged(with_cov(cov.tolist()), WIDE).as_json()
    xi = rng.multivariate_normal(np.zeros(6), cov, size=200_000)
    for key, part in (("error95_t_m", xi[:, :3]), ("error95_r_rad", xi[:, 3:])):
        drawn = np.quantile(np.linalg.norm(part, axis=1), 0.95)
        assert found["uncertainty"][key] == pytest.approx(drawn, rel=0.03)
    assert found["verdict"] == "pass"


def test_a_refused_result_stays_as_the_solver_said() -> None:
    refusal = Result(kind="hand-eye", verdict="fail", reasons=["too-few-poses"], result=None)
    assert judged(refusal, Acceptance(max_error_t_m=1e-9, max_error_r_rad=1e-9)) == refusal


def test_a_result_without_covariance_is_within_no_limit() -> None:
    subject = with_cov(None)
    found = judged(subject, WIDE)
    assert found.verdict == "fail"
    assert found.reasons[0].startswith("no covariance was found")
    assert found.result == subject.result


def test_solving_the_folder_again_gives_the_same_answer(tmp_path: Path) -> None:
    async def main() -> tuple[Path, dict[str, Any]]:
        async with open_cell(write_config(tmp_path)) as cell:
            await cell.run_job()
            return cell.folder(1).path, cell.result(1)

    folder, recorded = run_virtual(main())
    limits = json.loads((folder / "run.json").read_text("utf-8"))["job_config"]["accept"]
    assert (
        differences(recorded, solve_within_limits(folder / "capture.json", Acceptance(**limits)).as_json())
        == []
    )


@pytest.mark.parametrize("way_out", ["accept", "rollback"])
def test_a_value_edited_under_a_committed_one_refuses_jobs_until_somebody_decides(
    way_out: str, tmp_path: Path
) -> None:
    config = write_config(tmp_path, job={"accept": {"auto": True}})
    nominal = [0.0, -0.079, 0.05, 0.0, 0.0, 0.0]
    robot = config.robot.model_copy(update={"T_flange_camera_nominal": nominal})
    edited = config.model_copy(update={"robot": robot})

    async def first_life() -> list[float]:
        async with open_cell(config) as cell:
            await cell.run_job()
            value: list[float] = only_result(cell)["value"]
            return value

    async def second_life(committed: list[float]) -> None:
        async with open_cell(edited) as cell:
            conflict = await refused(cell.start())
            assert conflict.name == "RESULT_CONFLICT"
            assert "T_flange_camera_nominal" in conflict.detail
            assert len(list(cell.runs.iterdir())) == 1
            if way_out == "accept":
                await cell.engine.decisions.accept(only_result(cell)["id"], WHO)
            else:
                await cell.engine.decisions.rollback(NAME, WHO)
            run_id = await cell.start()
            used = cell.folder(run_id).info["values"]["calibration"]["eye-in-hand"]["X"]
            assert used == (committed if way_out == "accept" else nominal)
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(second_life(run_virtual(first_life())))


def test_a_conflict_that_nobody_met_yet_is_settled_by_accepting_too(tmp_path: Path) -> None:
    config = write_config(tmp_path, job={"accept": {"auto": True}})
    robot = config.robot.model_copy(update={"T_flange_camera_nominal": [0.0, -0.079, 0.05, 0.0, 0.0, 0.0]})

    async def first_life() -> None:
        async with open_cell(config) as cell:
            await cell.run_job()

    async def second_life() -> None:
        async with open_cell(config.model_copy(update={"robot": robot})) as cell:
            await cell.engine.decisions.accept(only_result(cell)["id"], WHO)
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(first_life())
    run_virtual(second_life())


def test_a_report_that_cannot_be_drawn_is_said_and_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon.results, "_write_report", GENUINE_REPORT)

    def broken(*what: Any) -> None:
        raise RuntimeError("no ink")

    monkeypatch.setattr("procedures.report.write.write_report", broken)

    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            assert (await cell.run_job())["outcome"] == "complete"
            assert only_result(cell)["state"] == "proposed"
            assert cell.notes(1, "no report")[0]["why"] == "RuntimeError: no ink"

    run_virtual(main())
