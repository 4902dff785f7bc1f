"""The solver's kinematics against the twin's, which composes screws instead of links."""

import numpy as np
import pytest

from calibration.kinematics import UrArmModel, robot_from_spec
from fakes.world.arm.kinematics import MODELS, LinkDeltas, chain

PARALLEL = (0.0, -204.0771054, 203.3923236, 0.6852734487, 0.0, 0.0)


@pytest.mark.parametrize("model", MODELS)
def test_both_put_the_drawings_flange_in_the_same_place(model: str) -> None:
    Q = np.random.default_rng(1).uniform(-3, 3, (30, 6))
    np.testing.assert_allclose(
        UrArmModel(model).forward_many(Q).as_matrix(), chain(model).matrix(Q), atol=1e-12
    )


@pytest.mark.parametrize("far_frames", [False, True])
def test_both_put_the_flange_of_a_calibrated_arm_in_the_same_place(far_frames: bool) -> None:
    rng = np.random.default_rng(2)
    calibration = {
        "delta_theta": rng.normal(0, 1e-3, 6).tolist(),
        "delta_d": (rng.normal(0, 3e-4, 6) + (PARALLEL if far_frames else 0.0)).tolist(),
        "delta_a": rng.normal(0, 3e-4, 6).tolist(),
        "delta_alpha": rng.normal(0, 1e-3, 6).tolist(),
    }
    arm = robot_from_spec({"model": "ur10e", "calibration": calibration})
    twin = chain("ur10e", LinkDeltas.from_mapping(calibration))
    Q = rng.uniform(-3, 3, (30, 6))
    np.testing.assert_allclose(arm.forward_many(Q).as_matrix(), twin.matrix(Q), atol=1e-9)
    for q in Q:
        np.testing.assert_allclose(arm.jacobian(q), twin.jacobian(q), atol=1e-8)
