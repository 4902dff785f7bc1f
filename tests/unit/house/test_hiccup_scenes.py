"""The scenes of the bench that stops processes: each job is configured there, and can begin."""

import numpy as np
import pytest

from bench.hiccups import SCENES, observed_kinematics
from calibration.identification.application import chain_of
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.registry import JOBS, SHIPPED


def test_every_shipped_job_has_a_scene() -> None:
    assert set(SCENES) == set(SHIPPED)


@pytest.mark.parametrize("job", ["eye-to-hand-check", "touch-test", "corrected-targets", "slot-insertion"])
def test_a_newer_job_is_configured_in_its_scene(job: str) -> None:
    section = Scenario.parse(SCENES[job].text).cell.job[job]
    JOBS[job].Config.model_validate({k: v for k, v in section.items()})


def test_the_palletizers_kinematics_are_those_of_the_twin() -> None:
    world = World.from_scenario(Scenario.parse(SCENES["corrected-targets"].text))
    value = observed_kinematics(world.truth(0.0))
    q = np.array([0.2, 1.4, -1.5, 0.3])
    assert world.observed is not None
    np.testing.assert_allclose(
        chain_of(value["robot"]).flange(q[None])[0], world.observed.true.flange(q).as_matrix(), atol=1e-9
    )
