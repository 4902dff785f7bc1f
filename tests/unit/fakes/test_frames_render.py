"""The twin's images against geometry computed here by hand and corners found by OpenCV."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from cell.devices import Intrinsics
from cell.errors import CellError
from fakes.frames.plates import make_plate
from fakes.frames.render import Optics, Renderer
from fakes.world.camera.printed import printed_target
from fakes.world.camera.truth import PrintTruth

CHARUCO = {
    "type": "charuco",
    "squares_x": 10,
    "squares_y": 7,
    "square_m": 0.025,
    "marker_m": 0.018,
    "dictionary": "DICT_5X5_100",
}
CENTRE = np.array([0.125, 0.0875, 0.0])
STRAIGHT = Intrinsics(1280, 800, (900.0, 902.0, 645.2, 398.7))
CURVED = Intrinsics(1280, 800, (802.4, 801.7, 644.2, 396.8), (-0.08, 0.05, 0.0005, -0.0004, -0.01))


def project(camera: Intrinsics, points: NDArray[Any]) -> NDArray[Any]:
    """Pinhole and Brown-Conrady as in the textbook, (n, 3) in the camera to (n, 2) pixels."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3 = camera.dist or (0.0,) * 5
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fx, fy, cx, cy = camera.K
    return np.column_stack([fx * xd + cx, fy * yd + cy])


def facing(rotvec: Sequence[float], distance_m: float, shift: Sequence[float] = (0.0, 0.0)) -> RigidTransform:
    """T_camera_target with the board's centre before the camera."""
    rotation = Rotation.from_rotvec(rotvec)
    return RigidTransform.from_components([*shift, distance_m] - rotation.apply(CENTRE), rotation)


def board_corners(ids: NDArray[Any]) -> NDArray[Any]:
    """Inner corners by number: x along 9, then y, the outer corner at the origin."""
    k = ids.ravel()
    return np.column_stack([k % 9 + 1, k // 9 + 1, np.zeros(len(k))]) * 0.025


def find_charuco(image: NDArray[np.uint8]) -> tuple[NDArray[Any], NDArray[Any]] | None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard((10, 7), 0.025, 0.018, dictionary))
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    corners, ids, _, _ = detector.detectBoard(grey)
    if ids is None:
        return None
    # The window stays inside the gap between square and marker: 900 px x 3.5 mm / 0.65 m is 4.8 px.
    return cv2.cornerSubPix(grey, corners, (3, 3), (-1, -1), (3, 50, 1e-4)).reshape(-1, 2), ids


@pytest.fixture(scope="module", params=[STRAIGHT, CURVED], ids=["no distortion", "distortion"])
def subject(request: pytest.FixtureRequest) -> Renderer:
    return Renderer(Optics(request.param), make_plate(CHARUCO))


def test_corners_found_by_opencv_lie_where_the_geometry_says(subject: Renderer) -> None:
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(15):
        pose = facing(rng.uniform(-0.5, 0.5, 3), rng.uniform(0.35, 0.65), rng.uniform(-0.2, 0.2, 2))
        found = find_charuco(subject.render([pose]).colour)
        if found is not None:
            corners, ids = found
            errors.append(corners - project(subject.optics.intrinsics, pose.apply(board_corners(ids))))
    error = np.concatenate(errors)
    assert len(error) > 400
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(error**2)) < 0.08


def test_corners_of_a_bowed_print_that_is_too_large_lie_where_the_geometry_says(
    subject: Renderer,
) -> None:
    """Against a bow by hand: 3 mm at the ends of the diagonal, which moves corners by up to 4 px."""
    print_ = printed_target(PrintTruth(scale_x=4e-3, scale_y=-3e-3, bow_m=3e-3, bow_rad=0.7), CHARUCO)
    bowed = Renderer(subject.optics, make_plate(CHARUCO, print_))
    all_corners = board_corners(np.arange(54)) * [1.004, 0.997, 1.0]
    middle = 0.5 * (all_corners[0] + all_corners[-1])
    across = (all_corners - middle) @ [np.cos(0.7), np.sin(0.7), 0.0]
    all_corners[:, 2] = 3e-3 * (across / across.max()) ** 2
    rng = np.random.default_rng(7)
    errors, flat = [], []
    for _ in range(15):
        pose = facing(rng.uniform(-0.5, 0.5, 3), rng.uniform(0.35, 0.65), rng.uniform(-0.2, 0.2, 2))
        found = find_charuco(bowed.render([pose]).colour)
        if found is not None:
            corners, ids = found
            camera = subject.optics.intrinsics
            errors.append(corners - project(camera, pose.apply(all_corners[ids.ravel()])))
            flat.append(corners - project(camera, pose.apply(board_corners(ids))))
    error = np.concatenate(errors)
    assert len(error) > 400
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(error**2)) < 0.08
    assert np.abs(np.concatenate(flat)).max() > 1.0


def test_depth_of_a_bowed_print_is_that_of_its_surface(subject: Renderer) -> None:
    print_ = printed_target(PrintTruth(bow_m=0.02), CHARUCO)
    pose = facing([0.2, -0.1, 0.1], 0.5)
    depth = Renderer(subject.optics, make_plate(CHARUCO, print_)).render([pose]).depth
    points = pose.apply(print_.placed(board_corners(np.arange(54))))
    u, v = np.rint(project(subject.optics.intrinsics, points)).astype(int).T
    error = depth[v, u] - 1000.0 * points[:, 2]
    assert abs(error.mean()) < 0.5
    assert error.std() < 1.5, "1 mm of noise, and rounding"


def test_depth_is_that_of_the_plane_along_the_optical_axis(subject: Renderer) -> None:
    pose = facing([0.4, -0.3, 0.2], 0.5)
    depth = subject.render([pose]).depth
    points = pose.apply(board_corners(np.arange(54)))
    u, v = np.rint(project(subject.optics.intrinsics, points)).astype(int).T
    error = depth[v, u] - 1000.0 * points[:, 2]
    assert depth.dtype == np.uint16
    assert abs(error.mean()) < 0.5
    assert error.std() < 1.5, "1 mm of noise, and rounding"
    assert abs(float(depth[:50, :50].mean()) - 1500.0) < 1.0, "the wall behind"


def test_a_moving_camera_blurs_about_the_middle_of_the_exposure(subject: Renderer) -> None:
    poses = [facing([0.1, 0.2, 0.0], 0.5, (dx, 0.0)) for dx in (-0.001, 0.0, 0.001)]
    found = find_charuco(subject.render(poses).colour)
    assert found is not None
    error = found[0] - project(subject.optics.intrinsics, poses[1].apply(board_corners(found[1])))
    assert np.abs(error.mean(axis=0)).max() < 0.03


@pytest.mark.parametrize(
    ("why", "pose"),
    [
        ("no board in the cell", None),
        ("seen from behind", facing([0.0, np.pi, 0.0], 0.5)),
        ("behind the camera", facing([0.0, 0.0, 0.0], -0.5)),
        ("beside the view", facing([0.0, 0.0, 0.0], 0.5, (2.0, 0.0))),
    ],
)
def test_no_board_is_found_when_there_is_none_to_see(
    subject: Renderer, why: str, pose: RigidTransform | None
) -> None:
    picture = subject.render([pose])
    assert find_charuco(picture.colour) is None, why
    assert picture.colour.std() > 5.0, "the background has texture"
    assert abs(float(picture.depth.mean()) - 1500.0) < 1.0


def test_a_short_exposure_is_dark(subject: Renderer) -> None:
    pose = facing([0.0, 0.0, 0.0], 0.5)
    assert subject.render([pose], gain=0.03).colour.mean() < 0.05 * subject.render([pose]).colour.mean()


def test_a_chessboard_has_its_origin_at_the_first_inner_corner() -> None:
    target = {"type": "chessboard", "columns": 8, "rows": 5, "square_m": 0.03}
    renderer = Renderer(Optics(STRAIGHT), make_plate(target))
    pose = RigidTransform.from_components([-0.1, -0.06, 0.5], Rotation.from_rotvec([0.2, 0.3, 0.1]))
    grey = cv2.cvtColor(renderer.render([pose]).colour, cv2.COLOR_BGR2GRAY)
    ok, corners = cv2.findChessboardCornersSB(grey, (8, 5))
    assert ok
    k = np.arange(40)
    truth = project(STRAIGHT, pose.apply(np.column_stack([k % 8, k // 8, 0 * k]) * 0.03))
    found = corners.reshape(-1, 2)
    error = min((found - truth, found[::-1] - truth), key=lambda e: float(np.abs(e).max()))
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.abs(error.mean(axis=0)).max() < 0.02


def test_a_marker_has_its_origin_in_the_middle_with_y_up_and_z_towards_the_camera() -> None:
    target = {"type": "aruco-marker", "dictionary": "DICT_4X4_50", "id": 7, "size_m": 0.08}
    renderer = Renderer(Optics(STRAIGHT), make_plate(target))
    upright = Rotation.from_rotvec([np.pi, 0.0, 0.0])
    pose = RigidTransform.from_components([0.02, -0.01, 0.4], Rotation.from_rotvec([0.1, 0.2, 0.1]) * upright)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    found, ids, _ = detector.detectMarkers(renderer.render([pose]).colour)
    assert ids.ravel().tolist() == [7]
    h = 0.04
    clockwise_from_upper_left = np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])
    error = found[0].reshape(4, 2) - project(STRAIGHT, pose.apply(clockwise_from_upper_left))
    # A marker's outer corners end in white paper: the refinement is known to be worse than on a saddle.
    assert np.abs(error).max() < 0.5


def test_a_circle_grid_has_its_origin_in_the_first_circle() -> None:
    target = {"type": "circle-grid", "columns": 7, "rows": 5, "spacing_m": 0.03}
    renderer = Renderer(Optics(STRAIGHT), make_plate(target))
    pose = RigidTransform.from_components([-0.09, -0.06, 0.5], Rotation.identity())
    ok, centres = cv2.findCirclesGrid(renderer.render([pose]).colour, (7, 5))
    assert ok
    k = np.arange(35)
    truth = project(STRAIGHT, pose.apply(np.column_stack([k % 7, k // 7, 0 * k]) * 0.03))
    found = centres.reshape(-1, 2)
    error = min((found - truth, found[::-1] - truth), key=lambda e: float(np.abs(e).max()))
    assert np.abs(error).max() < 0.1


@pytest.mark.parametrize(
    "target", [{"type": "points"}, {**CHARUCO, "dictionary": "DICT_NONE"}], ids=["type", "dictionary"]
)
def test_a_target_that_cannot_be_drawn_is_refused_in_a_sentence(target: dict[str, Any]) -> None:
    with pytest.raises(CellError) as caught:
        make_plate(target)
    assert caught.value.name == "DATA_INVALID"
