"""The whole check of a fixed camera on virtual time, judged against the twin's truth."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.poses import from_pose6, log_xi
from daemon.config import load_config
from fakes.object import run_virtual
from tests.kit.check_cell import CHECK, check_cell, config, erring_scenario, give_hand_eye
from tests.kit.ideal_world import ideal_text
from tests.kit.object_cell import ObjectCell, no_report, on_disk, open_cell

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

MAHALANOBIS_LIMIT = 22.5  # 99.9 % of a chi-squared with 6 degrees of freedom


def off_in_sigmas_squared(cell: ObjectCell, result: dict[str, Any]) -> float:
    found = from_pose6(result["result"]["T_camera_base"])
    xi = log_xi(found.inv() * from_pose6(cell.plant.world.truth()["T_base_camera"]).inv())
    return float(xi @ np.linalg.solve(np.array(result["result"]["cov"]), xi))


def test_a_good_hand_eye_passes_and_the_standard_is_right_within_its_uncertainty(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path)) as cell:
            end = await cell.run_job()
            result = cell.result(1)
            assert end["outcome"] == "complete", end
            assert result["result"]["blamed"] == "none"
            assert off_in_sigmas_squared(cell, result) < MAHALANOBIS_LIMIT
            assert len(result["result"]["places"]) >= 12
            assert cell.at_rest()

    run_virtual(main())


def test_a_hand_eye_is_judged_with_the_lens_that_was_found_with_it(tmp_path: Path) -> None:
    """A camera that tells its focal length 0.3 % wrong is where its calibration says."""
    scenario = tmp_path / "told.toml"
    told = "[world.camera.told]\nfocal = 0.003\n\n[world.target]"
    scenario.write_text(ideal_text("hand_eye_to_hand").replace("[world.target]", told, 1), "utf-8")

    async def main() -> None:
        async with open_cell(config(tmp_path, scenario=str(scenario)), job=CHECK) as cell:
            give_hand_eye(cell, lens=True)
            end = await cell.run_job()
            result = cell.result(1)
            assert end["outcome"] == "complete", end
            assert result["result"]["eval"]["t"] < 2e-4
            assert off_in_sigmas_squared(cell, result) < MAHALANOBIS_LIMIT

    run_virtual(main())


def test_a_camera_that_was_moved_is_blamed_and_a_new_pose_is_offered(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, propose="camera"), off_m=0.004) as cell:
            await cell.run_job()
            found = cell.result(1)
            assert found["result"]["blamed"] == "X"
            assert found["verdict"] == "fail"
            assert found["reasons"][0].startswith("max_error_t_m")

    run_virtual(main())


def test_the_constant_that_corrects_targets_is_offered_as_the_hand_eye(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, propose="constant"), off_m=0.0008) as cell:
            await cell.run_job()
            correction = cell.result(1)["result"]["correction"]
            assert correction["chosen"] == "constant"
            (offered,) = cell.ledger.waiting_results()
            assert offered["name"] == "T_base_camera"
            true = from_pose6(cell.plant.world.truth()["T_base_camera"]).translation
            off = np.linalg.norm(from_pose6(correction["T_base_camera"]).translation - true)
            assert off < 2e-4

    run_virtual(main())


def test_no_constant_is_offered_where_none_is_better(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, propose="constant")) as cell:
            await cell.run_job()
            assert cell.result(1)["result"]["correction"]["chosen"] == "none"
            assert cell.ledger.waiting_results() == []

    run_virtual(main())


def test_a_target_that_is_not_where_the_drawing_has_it_is_blamed(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, off_m=0.004)) as cell:
            await cell.run_job()
            assert cell.result(1)["result"]["blamed"] == "C"

    run_virtual(main())


def test_accepted_kinematics_correct_the_daemons_own_moves_and_the_camera_sees_it(tmp_path: Path) -> None:
    scenario = erring_scenario(tmp_path)

    async def positioning(use: bool) -> tuple[float, str]:
        config(tmp_path, scenario=scenario, propose="kinematics", poses=24)
        toml = tmp_path / "cell.toml"
        toml.write_text(
            toml.read_text().replace("[robot]", f"[robot]\nuse_kinematics = {str(use).lower()}", 1)
        )
        async with open_cell(load_config(toml), job=CHECK) as cell:
            if not use:
                give_hand_eye(cell)
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete", end
            if not use:
                (offered,) = cell.ledger.waiting_results()
                assert offered["name"] == "kinematics.arm"
                on_disk(cell.ledger.accept, offered["id"], "test")
            answer = cell.result(run_id)["result"]
            return answer["positioning"]["t_rms"], answer["correction"]["chosen"]

    before, way = run_virtual(positioning(use=False))
    after, _ = run_virtual(positioning(use=True))
    print(f"positioning {1e3 * before:.3f} mm RMS ({way}), {1e3 * after:.3f} mm with the accepted kinematics")
    assert way == "model"
    assert after < before / 3.0
