"""OpenCV's own solvers, fed by the object face alone, find the truth of the shipped scenarios."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.devices import Frame, Speed, ToolSettings
from cell.poses import from_pose6, log_xi
from fakes.object import ObjectArm, ObjectCamera, VirtualClock, run_virtual
from fakes.world.targets import target_points

FAST = Speed(0.5, 2.0, 1.5, 4.0)
HERE = Path(__file__).parent  # this face writes nothing there


async def capture(
    scenario: str, board_ahead_m: float
) -> tuple[list[RigidTransform], list[RigidTransform], dict[str, Any]]:
    """Reported flange poses, board poses by PnP, and the truth, for twelve poses of the first placement."""
    clock = VirtualClock()
    arm = ObjectArm("arm", ObjectArm.Config(scenario=scenario), clock)
    camera = ObjectCamera("camera", ObjectCamera.Config(scenario=scenario), clock)
    await arm.open()
    await camera.open()
    await camera.set_target(arm.world.target)
    port = await arm.open_motion(ToolSettings(arm.world.T_flange_tool, 1.0))
    start = arm.state.latest(0.1).value.T_base_flange
    points = target_points(arm.world.target)
    flanges, boards = [], []
    for k in range(12):
        turn = 0.28 * np.array([np.cos(2.4 * k), np.sin(2.4 * k), 1.5 * np.sin(k)])
        # Turning about the board's middle keeps it in view.
        middle = RigidTransform.from_translation([0.0, 0.0, board_ahead_m])
        turned = middle * RigidTransform.from_rotation(Rotation.from_rotvec(turn)) * middle.inv()
        await port.move_linear(start * turned, FAST)
        frames = await camera.capture(3, HERE, "x", clock.now())
        flanges.append(arm.state.latest(0.1).value.T_base_flange)
        boards.append(solve_pnp(points, frames))
    truth = arm.world.truth()
    await port.close()
    await camera.close()
    await arm.close()
    return flanges, boards, truth


def solve_pnp(points: np.ndarray, frames: Any) -> RigidTransform:
    views: list[Frame] = list(frames)
    assert all(f.board is not None and len(f.board.ids) == 54 for f in views)
    corners = np.mean([f.board.corners for f in views if f.board is not None], axis=0)
    camera = views[0].intrinsics
    ok, turn, shift = cv2.solvePnP(points, corners, camera.matrix, np.array(camera.dist))
    assert ok
    return from_pose6([*shift.ravel(), *turn.ravel()])


@pytest.mark.parametrize(
    ("scenario", "found", "board_ahead_m", "invert"),
    [
        ("hand_eye:ideal", "T_flange_camera", 0.5, False),
        ("hand_eye_to_hand:ideal", "T_base_camera", 0.03, True),
    ],
)
def test_opencv_recovers_where_the_camera_truly_is(
    scenario: str, found: str, board_ahead_m: float, invert: bool
) -> None:
    flanges, boards, truth = run_virtual(capture(scenario, board_ahead_m))
    gripper = [T.inv() if invert else T for T in flanges]
    R, t = cv2.calibrateHandEye(
        [T.rotation.as_matrix() for T in gripper],
        [T.translation for T in gripper],
        [T.rotation.as_matrix() for T in boards],
        [T.translation for T in boards],
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    X = RigidTransform.from_components(t.ravel(), Rotation.from_matrix(R))
    off = log_xi(from_pose6(truth[found]).inv() * X)
    assert np.linalg.norm(off[:3]) < 0.0005
    assert np.linalg.norm(off[3:]) < 0.001
