"""What has to be commanded: the believed inverse of the command must bring the *true* flange to its place."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.identification.solution import identify
from calibration.kinematics import UrArmModel, measured_arm, robot_from_spec
from calibration.kinematics.families import arm_spec, robot_document
from cell.errors import CellError
from cell.formats.robot import parse_robot
from cell.modelled_arm import ArmModels
from cell.run_values import RunValues
from procedures.iso9283.config import Iso9283Config
from procedures.iso9283.plan import kinematics_of, require_same_devices
from tests.kit.kincal_scene import joints, make_scene


def test_a_controller_that_inverts_its_own_model_then_brings_the_true_flange_there() -> None:
    scene = make_scene("ur10e", 3, 120, noise=1e-6)
    solved = identify(scene.problem, {})
    spec = arm_spec(parse_robot(scene.data["robot"], "robot"))
    own = len(solved.model.arm.names)
    tools = dict(zip(solved.model.targets, solved.model.tools(solved.x), strict=True))
    believed = UrArmModel("ur10e")
    document = robot_document(spec, solved.model.arm, solved.x[:own], tools)
    subject = ArmModels(measured_arm({"model": "ur10e"}, document), believed)
    # The place of the reflector is what was measured: its error is that of the arm and not of the gauge.
    tool, truth = tools["smr1"], scene.truth
    registration = solved.registration
    off, uncorrected = [], []
    for q in joints("ur10e", np.random.default_rng(5), 20):
        wanted = subject.own.forward(q)
        p_wanted = registration.to_tracker(wanted.apply(tool)[:, None])[:, 0]
        near = q + 0.01
        told = subject.told(wanted, near)
        for target, list_ in ((told, off), (wanted, uncorrected)):
            q_told = believed.inverse(target, near)
            assert q_told is not None
            reached = truth.p_tracker(q_told[None], ["smr1"])[0]
            list_.append(np.linalg.norm(reached - p_wanted))
    assert max(off) < 5e-6
    assert np.median(uncorrected) > 1e-3


def test_a_pose_out_of_reach_is_refused_with_its_place() -> None:
    arm = robot_from_spec({"model": "ur10e"})
    far = RigidTransform.from_components([5.0, 0.0, 0.0], Rotation.identity())
    with pytest.raises(CellError, match=r"5\.000, 0\.000, 0\.000") as caught:
        ArmModels(arm, arm).told(far, np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0]))
    assert caught.value.name == "MOTION_UNREACHABLE"


def test_kinematics_of_another_payload_do_not_correct() -> None:
    config = Iso9283Config.model_construct(corrected=True, registration="fit")
    measured = {"arm": {"payload_kg": 2.0, "robot": {"model": "ur10e"}}}
    values = RunValues({"model": "ur10e"}, kinematics=measured, payload_kg=2.0)
    assert kinematics_of(values, config) is measured["arm"]
    with pytest.raises(CellError, match=r"measured with 2 kg, payload_kg with this tool is 5") as caught:
        kinematics_of(replace(values, payload_kg=5.5), config)
    assert caught.value.name == "PAYLOAD_DIFFERS"


def test_kinematics_of_another_arm_or_seen_by_another_tracker_do_not_correct() -> None:
    found = {"serials": {"arm": "9999-1", "tracker": "9999-2"}}
    fit, placed = (
        Iso9283Config.model_construct(corrected=True, registration=how) for how in ("fit", "kinematics")
    )
    require_same_devices(found, placed, found["serials"])
    require_same_devices(found, fit, {"arm": "9999-1", "tracker": "9999-7"})
    require_same_devices({}, placed, found["serials"])
    for config, role, serials in (
        (fit, "arm", {**found["serials"], "arm": "9999-7"}),
        (placed, "tracker", {**found["serials"], "tracker": "9999-7"}),
    ):
        with pytest.raises(CellError, match=f"and this is {role} 9999-7") as caught:
            require_same_devices(found, config, serials)
        assert caught.value.name == "ISO9283_NO_KINEMATICS"
