"""Where the arm stands, as somebody who teaches a pose is told."""

from pathlib import Path

import numpy as np

from fakes.object import run_virtual
from tests.kit.object_cell import WHO, open_cell, refused, write_config


def test_joints_are_those_of_now_and_an_arm_that_moves_or_is_silent_says_so(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            told = cell.engine.joints()
            np.testing.assert_allclose(told["q"], cell.plant.world.track.at(cell.clock.now())[0], atol=1e-3)
            assert told["moving"] is False
            run_id = await cell.start()
            await cell.until_state("move")
            while not cell.engine.joints()["moving"]:
                await cell.clock.sleep(0.05)
            await cell.engine.halt(WHO)
            await cell.finished(run_id)
            cell.plant.plant("arm").inject("silence", {"duration_s": 5.0})
            await cell.clock.sleep(1.0)

            async def asked() -> object:
                return cell.engine.joints()

            assert "too old to be used" in str(await refused(asked()))

    run_virtual(main())
