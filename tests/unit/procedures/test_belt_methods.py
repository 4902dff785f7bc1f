"""Meeting an item without following it, by our forecast and by the classic method; how late an arm is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.devices import TrajectoryPiece
from fakes.object import run_virtual
from procedures.belt.motion.servo_lag import Lag
from tests.kit.object_cell import no_report
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config

__all__ = ["no_report"]
TOLERANT = {"confirm": "7\nwithin_m = 0.05\nbelow_m_s = 1.0"}  # fingers that take what slides


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize("job", [{"method": "classic"}, {"method": "ml", "follow": False}])
def test_an_item_that_is_met_and_not_followed_slides_under_the_tool(
    tmp_path: Path, job: dict[str, Any]
) -> None:
    async def scene() -> None:
        config = picking_config(tmp_path, {"picks": 1, **job}, TOLERANT)
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert cell.result(run_id)["result"]["method"] == job["method"]
            gripper = cell.plant.world.gripper
            assert gripper is not None
            (contact,) = [c for c in gripper.contacts if c.taken]
            assert contact.slide_m_s == pytest.approx(0.15, abs=0.01)
            assert np.linalg.norm(contact_errors(cell)) < 0.02

    run_virtual(scene())


def test_a_lag_is_measured_on_the_arms_own_state_and_taken_off() -> None:
    subject, lag = Lag(), 0.006
    slope = np.array([0.4, -0.2, 0.0, 0.3, 0.0, 0.1])
    for t in np.arange(0.0, 4.0, 0.02):
        sent = subject.ahead(TrajectoryPiece(t, t + 0.1, np.array([t * slope, slope])))
        assert sent.t1 - sent.t0 == pytest.approx(0.1)
        now = t + 0.01
        # An arm that is late by ``lag`` on what it was sent, which was sent early.
        subject.look(now, (now + subject.s - lag) * slope)
    assert subject.s == pytest.approx(lag, abs=2e-4)


def test_an_arm_at_rest_tells_nothing_about_its_lag() -> None:
    subject = Lag()
    subject.ahead(TrajectoryPiece(0.0, 1.0, np.zeros((2, 6))))
    subject.look(0.5, np.full(6, 0.01))
    assert subject.s == 0.0
