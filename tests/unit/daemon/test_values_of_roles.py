"""A run resolves the calibrations of the devices that it uses, and those alone."""

from pathlib import Path

from fakes.object import run_virtual
from tests.kit.laser_cell import laser_config
from tests.kit.object_cell import on_disk, open_cell, refused


def test_a_camera_in_conflict_does_not_refuse_a_job_without_a_camera(tmp_path: Path) -> None:
    config = laser_config(tmp_path, scenario="bay:ideal")

    async def main() -> None:
        async with open_cell(config, job="laser-reference") as cell:
            other = [0.0, -0.07, 0.05, 0.0, 0.0, 0.0]
            value = [0.001, -0.08, 0.05, 0.0, 0.0, 0.0]
            on_disk(cell.ledger.accept, cell.ledger.propose("T_flange_camera", value, {}, 0, other), "test")
            assert (await refused(cell.start(job="cone-capture"))).name == "RESULT_CONFLICT"
            run_id = await cell.start()
            used = cell.folder(run_id).info["values"]
            assert sorted(used["versions"]) == []
            assert sorted(used["configured"]) == [
                "T_flange_tool.gripper", "kinematics.arm", "laser_reference.gripper", "time_offset_s.beams",
            ]  # fmt: skip
            await cell.engine.abort("test")
            await cell.finished(run_id)

    run_virtual(main())
