"""The delay of a camera from pictures that are made from a known delay, play and shutter."""

import numpy as np
import pytest

from calibration.hand_eye import se3
from calibration.hand_eye.problem import Setup
from calibration.hand_eye.views import project
from calibration.latency.delay import Delay, DelayUndetermined
from calibration.latency.pictures import Look, Way, solve_pictures
from cell.devices import Intrinsics

CAMERA = Intrinsics(1280, 800, (800.0, 801.0, 640.0, 400.0), (0.02, -0.04, 0.0005, -0.0004, 0.0))
POINTS = np.array([[0.03 * i, 0.03 * j, 0.0] for i in range(7) for j in range(5)])
LATE_S, PLAY_M, ROW_S, WAY_M = 0.015, 0.0003, 2e-5, 0.2
X_IN_HAND = se3.exp(np.array([0.02, -0.05, 0.06, 0.02, -0.03, 0.4]))
FIXED = se3.exp(np.array([0.1, 0.5, 1.2, np.pi - 0.05, 0.03, 0.02]))
TO_FIRST_LINE = {"eye-in-hand": np.array([0.4, 0.1, 0.6, np.pi, 0.0, 0.0]),
                 "eye-to-hand": np.array([0.0, 0.5, 0.5, 0.0, 0.0, 0.3])}  # fmt: skip


def made(
    setup: Setup, speeds: tuple[float, ...], pairs: int, seed: int = 1, shutter: float = ROW_S
) -> tuple[np.ndarray, list[Way], list[Look]]:
    """Pictures ten times a second on ways out and back at each speed; (X, ways, looks)."""
    rng = np.random.default_rng(seed)
    X = X_IN_HAND if setup == "eye-in-hand" else FIXED
    base = se3.exp(TO_FIRST_LINE[setup])
    board = np.eye(4)  # the target before the camera at the middle of the way
    board[:3, 3] = [-0.09, -0.06, 0.55]
    middle = base.copy()
    middle[0, 3] += 0.5 * WAY_M
    W = middle @ X @ board if setup == "eye-in-hand" else se3.inverse(middle) @ X @ board
    ways: list[Way] = []
    looks: list[Look] = []
    t = 100.0
    for pair, speed in enumerate(speed for speed in speeds for _ in range(pairs)):
        for direction in (1, -1):
            span = 0.3 + WAY_M / speed + 0.3
            stamps = np.arange(t, t + span, 0.004)
            gone = np.clip((stamps - t - 0.3) * speed, 0.0, WAY_M)
            s = gone if direction > 0 else WAY_M - gone
            T = np.repeat(base[None], len(stamps), axis=0)
            T[:, 0, 3] += s
            ways.append(Way(pair, direction, speed, stamps, T))
            for shot in np.arange(t + 0.05 + 0.1 * rng.random(), t + span - 0.05, 0.1):
                corners = np.zeros((len(POINTS), 2))
                rows = np.full(len(POINTS), 400.0)
                for _ in range(3):
                    at = np.interp(shot + shutter * rows, stamps, s) - 0.5 * direction * PLAY_M
                    B = np.repeat(base[None], len(POINTS), axis=0)
                    B[:, 0, 3] += at
                    into = se3.inverse(B @ X) @ W if setup == "eye-in-hand" else se3.inverse(X) @ B @ W
                    p = (into[:, :3, :3] @ POINTS[..., None])[..., 0] + into[:, :3, 3]
                    corners = project(p[:, :2] / p[:, 2:], CAMERA)
                    rows = corners[:, 1]
                corners = corners + 0.2 * rng.standard_normal(corners.shape)
                stamp = shot + LATE_S + 1e-4 * rng.standard_normal()
                looks.append(Look(len(ways) - 1, stamp, ROW_S, POINTS, corners))
            t += span
    known = X @ se3.exp(np.array([0.004, -0.003, 0.005, 0.01, -0.008, 0.012]))  # from the drawing
    return known, ways, looks


def found(setup: Setup, *args: object, **how: object) -> Delay:
    return solve_pictures(setup, CAMERA, *made(setup, *args, **how))  # type: ignore[arg-type]


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_delay_and_play_are_found_together_through_a_rolling_shutter(setup: Setup) -> None:
    subject = found(setup, (0.05, 0.2), 3)
    low, high = subject.interval95
    assert low < LATE_S < high
    assert high - low < 0.001
    assert subject.hysteresis is not None
    assert subject.sigma_hysteresis is not None
    assert abs(subject.hysteresis - PLAY_M) < 3.0 * subject.sigma_hysteresis
    assert np.sqrt(np.mean(subject.heldout**2)) < 0.0001


def test_a_shutter_that_rolls_although_the_camera_says_otherwise_is_part_of_the_delay() -> None:
    """Of the 400 rows, about, on which the target is."""
    subject = found("eye-to-hand", (0.05, 0.2), 2, shutter=0.0)
    assert subject.tau == pytest.approx(LATE_S + 400.0 * ROW_S, abs=0.001)


def test_at_one_speed_the_play_is_part_of_the_delay() -> None:
    subject = found("eye-to-hand", (0.1,), 4)
    assert subject.hysteresis is None
    assert subject.tau == pytest.approx(LATE_S + 0.5 * PLAY_M / 0.1, abs=0.0005)


def test_the_stated_interval_holds_as_often_as_it_says() -> None:
    inside = [low < LATE_S < high for low, high in (
        found("eye-to-hand", (0.05, 0.2), 2, seed).interval95 for seed in range(5)
    )]  # fmt: skip
    assert sum(inside) >= 3  # of 5 at 95 %: fewer has a chance of a thousandth


def test_ways_that_show_no_target_are_refused_by_name() -> None:
    X, ways, looks = made("eye-to-hand", (0.1,), 4)
    with pytest.raises(DelayUndetermined, match=r"^too-few-pictures: 4 pictures"):
        solve_pictures("eye-to-hand", CAMERA, X, ways, looks[:4])
