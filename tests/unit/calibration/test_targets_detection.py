"""Targets found in images that OpenCV drew: right numbers, right places, whatever way they are turned."""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.targets import make_target
from calibration.targets.base import grid_symmetries, refine_corners
from cell.errors import InputError

CHARUCO = {
    "type": "charuco",
    "squares_x": 8,
    "squares_y": 6,
    "square_m": 0.025,
    "marker_m": 0.018,
    "dictionary": "DICT_5X5_100",
}
CHESSBOARD = {"type": "chessboard", "columns": 8, "rows": 5, "square_m": 0.03}
CIRCLES = {"type": "circle-grid", "columns": 7, "rows": 5, "spacing_m": 0.03, "large_dot_corner": True}
MARKER = {"type": "aruco-marker", "dictionary": "DICT_APRILTAG_36h11", "id": 7, "size_m": 0.1}
K = np.array([[1000.0, 0, 639.5], [0, 1000.0, 399.5], [0, 0, 1]])


def drawn(
    plate: np.ndarray, pitch: float, rvec: list[float], t: list[float]
) -> tuple[np.ndarray, np.ndarray]:
    """A picture 1280 x 800 of a plate with ``pitch`` metres a pixel, and its homography."""
    R, _ = cv2.Rodrigues(np.array(rvec, dtype=float))
    H = K @ np.column_stack([R[:, 0] * pitch, R[:, 1] * pitch, np.array(t, dtype=float)])
    big = cv2.warpPerspective(
        plate, np.diag([2.0, 2.0, 1.0]) @ H, (2560, 1600), flags=cv2.INTER_AREA, borderValue=190
    )
    return cv2.GaussianBlur(cv2.resize(big, (1280, 800), interpolation=cv2.INTER_AREA), (3, 3), 0.6), H


def seen_at(H: np.ndarray, plate_px: np.ndarray) -> np.ndarray:
    """Image coordinates of plate pixels; halving the picture shifts pixel centres by a quarter of one."""
    p = np.column_stack([plate_px, np.ones(len(plate_px))]) @ H.T
    return p[:, :2] / p[:, 2:] - 0.25


def charuco_plate(spec: Mapping[str, Any]) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec["dictionary"]))
    board = cv2.aruco.CharucoBoard(
        (spec["squares_x"], spec["squares_y"]), spec["square_m"], spec["marker_m"], dictionary
    )
    board.setLegacyPattern(spec.get("legacy", False))
    size = (spec["squares_x"] * 100, spec["squares_y"] * 100)
    return cv2.copyMakeBorder(board.generateImage(size), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)


def chess_plate(columns: int, rows: int, dark: int = 0, light: int = 255) -> np.ndarray:
    y, x = np.mgrid[: (rows + 1) * 100, : (columns + 1) * 100] // 100
    plate = np.where((x + y) % 2 == 0, dark, light).astype(np.uint8)
    return cv2.copyMakeBorder(plate, 80, 80, 80, 80, cv2.BORDER_CONSTANT, value=light)


def circle_plate(columns: int, rows: int, large: tuple[int, int] | None) -> np.ndarray:
    plate = np.full((rows * 100 + 100, columns * 100 + 100), 255, np.uint8)
    for r in range(rows):
        for c in range(columns):
            radius = 36 if (c, r) == large else 22
            cv2.circle(plate, (100 + c * 100, 100 + r * 100), radius, 0, -1, cv2.LINE_AA)
    return plate


@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_corners_are_numbered_and_placed(legacy: bool) -> None:
    spec = {**CHARUCO, "legacy": legacy}
    subject = make_target(spec)
    image, H = drawn(charuco_plate(spec), 0.00025, [0.3, -0.25, 0.4], [-0.08, -0.09, 0.42])
    found = subject.detect(image)
    assert found is not None
    assert list(found.ids) == list(range(35))
    where = seen_at(H, subject.points[:, :2] / 0.00025 + 60 - 0.5)
    assert np.sqrt(np.mean((found.corners - where) ** 2)) < 0.1


def test_a_legacy_board_is_not_taken_for_a_modern_one() -> None:
    image, _ = drawn(charuco_plate({**CHARUCO, "legacy": True}), 0.00025, [0, 0, 0], [-0.1, -0.08, 0.4])
    found = make_target(CHARUCO).detect(image)
    assert found is None or len(found.ids) < 10


def test_half_a_charuco_board_keeps_its_numbers() -> None:
    subject = make_target(CHARUCO)
    image, H = drawn(charuco_plate(CHARUCO), 0.00025, [0, 0.2, 0], [-0.28, -0.08, 0.35])
    found = subject.detect(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    assert found is not None
    assert 5 < len(found.ids) < 35
    where = seen_at(H, subject.points[found.ids, :2] / 0.00025 + 60 - 0.5)
    assert np.sqrt(np.mean((found.corners - where) ** 2)) < 0.15


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.5, -2.0])
@pytest.mark.parametrize("light", [250, 22])
def test_chessboards_are_found_bright_and_dark_up_to_their_symmetry(turn: float, light: int) -> None:
    subject = make_target(CHESSBOARD)
    plate = chess_plate(8, 5, light // 5, light)
    R, _ = cv2.Rodrigues(np.array([0.2, 0.1, 0]))
    R = R @ cv2.Rodrigues(np.array([0, 0, turn]))[0]
    t = np.array([0, 0, 0.55]) - R @ np.array([530 * 0.0003, 380 * 0.0003, 0])
    image, H = drawn(plate, 0.0003, cv2.Rodrigues(R)[0].ravel().tolist(), t.tolist())
    if light < 100:
        image = np.minimum(image, light)
    found = subject.detect(image)
    assert found is not None
    where = seen_at(H, subject.points[:, :2] / 0.0003 + 180 - 0.5)
    errors = [np.sqrt(np.mean((found.corners - where[s]) ** 2)) for s in subject.symmetries]
    assert min(errors) < (0.1 if light > 100 else 0.25)
    assert len(errors) == 2


@pytest.mark.parametrize("turn", [0.0, 1.7, 3.1, -1.4])
@pytest.mark.parametrize("large", [(0, 0), (6, 0), (0, 4), (6, 4)])
def test_the_large_dot_is_the_first_point_of_a_circle_grid(turn: float, large: tuple[int, int]) -> None:
    subject = make_target(CIRCLES)
    R, _ = cv2.Rodrigues(np.array([0.0, 0.0, turn]))
    t = np.array([0, 0, 0.5]) - R @ np.array([400 * 0.0003, 300 * 0.0003, 0])
    image, H = drawn(circle_plate(7, 5, large), 0.0003, cv2.Rodrigues(R)[0].ravel().tolist(), t.tolist())
    found = subject.detect(image)
    assert found is not None
    step = (1 if large[0] == 0 else -1, 1 if large[1] == 0 else -1)
    r, c = np.mgrid[:5, :7]
    plate = np.column_stack(
        [100 + 100 * (large[0] + step[0] * c.ravel()), 100 + 100 * (large[1] + step[1] * r.ravel())]
    )
    assert np.sqrt(np.mean((found.corners - seen_at(H, plate)) ** 2)) < 0.3


def test_a_circle_grid_without_its_large_dot_is_not_numbered_by_guess() -> None:
    image, _ = drawn(circle_plate(7, 5, None), 0.0003, [0, 0, 0], [-0.12, -0.09, 0.5])
    assert make_target(CIRCLES).detect(image) is None
    assert make_target({**CIRCLES, "large_dot_corner": False}).detect(image) is not None


def test_marker_corners_run_clockwise_from_the_top_left() -> None:
    subject = make_target(MARKER)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    plate = cv2.copyMakeBorder(
        cv2.aruco.generateImageMarker(dictionary, 7, 400), 100, 100, 100, 100, cv2.BORDER_CONSTANT, value=255
    )
    image, H = drawn(plate, 0.00025, [0.2, 0.3, 0.5], [-0.05, -0.1, 0.5])
    found = subject.detect(image)
    assert found is not None
    corners = np.array([[99.5, 99.5], [499.5, 99.5], [499.5, 499.5], [99.5, 499.5]])
    assert np.sqrt(np.mean((found.corners - seen_at(H, corners)) ** 2)) < 0.25
    assert np.allclose(
        subject.points, [[-0.05, 0.05, 0], [0.05, 0.05, 0], [0.05, -0.05, 0], [-0.05, -0.05, 0]]
    )


def test_two_markers_with_one_number_are_no_target() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    one = cv2.copyMakeBorder(
        cv2.aruco.generateImageMarker(dictionary, 7, 160), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255
    )
    assert make_target(MARKER).detect(np.hstack([one, one])) is None
    assert make_target(MARKER).detect(one) is not None


@pytest.mark.parametrize("spec", [CHARUCO, CHESSBOARD, CIRCLES, MARKER])
def test_nothing_is_found_in_noise(spec: dict[str, Any]) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (400, 640), dtype=np.uint8)
    assert make_target(spec).detect(noise) is None


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        ({"type": "qr"}, "type"),
        ({**CHARUCO, "dictionary": "DICT_9X9_1"}, "dictionary"),
        ({**CHARUCO, "dictionary": "imread"}, "dictionary"),
        ({**CHARUCO, "marker_m": 0.03}, "marker_m"),
    ],
)
def test_targets_that_do_not_exist_are_refused_by_field(spec: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=f"target.{word}"):
        make_target(spec)


def test_symmetries_of_a_square_grid_are_four_and_of_another_two() -> None:
    assert [len(grid_symmetries(*size)) for size in ((4, 4), (4, 3))] == [4, 2]
    assert list(grid_symmetries(3, 2)[1]) == [5, 4, 3, 2, 1, 0]


def test_a_wide_window_would_be_drawn_to_a_foreign_edge() -> None:
    image = np.full((60, 60), 255, np.uint8)
    image[:30, :30] = image[30:, 30:] = 0
    image[33:60, 10:27] = 0  # a marker's edge 3 pixels below the square's corner
    image = cv2.GaussianBlur(image, (3, 3), 0.7)
    corner = np.array([[29.0, 29.8]])
    near = refine_corners(image, corner, np.array([3.0]))
    far = refine_corners(image, corner, np.array([9.0]))
    assert np.linalg.norm(near - 29.5) < 0.1
    assert np.linalg.norm(far - 29.5) > 2 * np.linalg.norm(near - 29.5)


def test_a_marker_too_small_for_single_precision_is_refused_by_a_sentence() -> None:
    with pytest.raises(InputError, match=r"must be at least 0\.0001 m"):
        make_target({**CHARUCO, "marker_m": 5e-324})
