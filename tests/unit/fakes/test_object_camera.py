"""The camera of the object face beyond the common contract: noise, geometry, faults."""

from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from fakes.object import ObjectArm, ObjectCamera, VirtualClock, run_virtual
from fakes.world.targets import target_points
from tests.kit.ideal_world import ideal_text
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report"]

HERE = Path(__file__).parent  # this face writes nothing there

Scene = Callable[[ObjectCamera], Coroutine[Any, Any, Any]]


@pytest.fixture
def subject() -> Callable[[Scene], Any]:
    def play(scene: Scene) -> Any:
        async def whole() -> Any:
            camera = ObjectCamera("camera", ObjectCamera.Config(scenario="hand_eye:ideal"), VirtualClock())
            await camera.open()
            await camera.set_target(camera.world.target)
            try:
                return await scene(camera)
            finally:
                await camera.close()

        return run_virtual(whole())

    return play


def test_pixel_noise_is_new_in_each_frame_and_of_the_size_in_the_scenario(
    subject: Callable[[Scene], Any],
) -> None:
    async def scene(camera: ObjectCamera) -> np.ndarray:
        frames = await camera.capture(60, HERE, "x", camera.clock.now())
        return np.array([f.board.corners for f in frames if f.board is not None])

    corners = subject(scene)
    assert corners.shape == (60, 54, 2)
    # 60 * 108 draws: the estimate is good to about one per cent.
    assert np.std(corners - corners.mean(axis=0)) * np.sqrt(60 / 59) == pytest.approx(0.05, rel=0.05)


def test_two_runs_see_the_same_pixels(subject: Callable[[Scene], Any]) -> None:
    async def scene(camera: ObjectCamera) -> bytes:
        (frame,) = await camera.capture(1, HERE, "x", camera.clock.now())
        assert frame.board is not None
        return frame.board.corners.tobytes()

    assert subject(scene) == subject(scene)


def test_a_board_is_found_however_well_its_print_is_known(subject: Callable[[Scene], Any]) -> None:
    async def scene(camera: ObjectCamera) -> list[bool]:
        found = []
        for change in ({}, {"scale_sigma": 2e-4, "flatness_m": 5e-5}, {"squares_x": 11}):
            await camera.set_target(camera.world.target | change)
            (frame,) = await camera.capture(1, HERE, "x", camera.clock.now())
            found.append(frame.board is not None)
        return found

    assert subject(scene) == [True, True, False]


def test_corners_outside_the_picture_are_not_reported(subject: Callable[[Scene], Any]) -> None:
    async def scene(camera: ObjectCamera) -> None:
        arm = ObjectArm("arm", ObjectArm.Config(scenario="hand_eye:ideal"), camera.clock)
        world = arm.world
        now = camera.clock.now()
        end = world.track.start_joint_move(now, world.track.at(now)[0] + [0.5, 0, 0, 0, 0, 0], 1.0, 5.0)
        await camera.clock.sleep(end - now)
        (frame,) = await camera.capture(1, HERE, "x", camera.clock.now())
        assert frame.board is not None
        assert 0 < len(frame.board.ids) < 54
        assert np.all(frame.board.corners > 0)
        assert np.all(frame.board.corners < [1280, 800])
        assert list(frame.board.ids) == sorted(frame.board.ids)

    subject(scene)


def test_a_board_seen_from_behind_is_not_found(subject: Callable[[Scene], Any]) -> None:
    async def scene(camera: ObjectCamera) -> None:
        world = camera.world
        now = camera.clock.now()
        q = world.track.at(now)[0].copy()
        q[4] += np.pi
        world.track.hold(now, q)
        await camera.clock.sleep(0.2)
        (frame,) = await camera.capture(1, HERE, "x", camera.clock.now())
        assert frame.board is None

    subject(scene)


def test_a_capture_after_a_pause_draws_no_pictures_of_the_pause_and_the_same_ones_as_without_it(
    subject: Callable[[Scene], Any],
) -> None:
    def scene(looked_at: bool) -> Scene:
        async def play(camera: ObjectCamera) -> tuple[int, list[bytes]]:
            drawn, view = [], camera.head.view
            camera.head.view = lambda *a: (drawn.append(a), view(*a))[1]  # type: ignore[method-assign]
            for _ in range(20):
                await camera.clock.sleep(1.0)
                if looked_at:
                    camera.frames.last()
            after = camera.clock.now() - 0.3
            before, frames = len(drawn), await camera.capture(3, HERE, "x", after)
            assert [f.board is not None for f in frames] == [True] * 3
            assert all(f.t_exposure - f.exposure_s / 2.0 >= after for f in frames)
            return len(drawn) - before, [f.board.corners.tobytes() for f in frames if f.board is not None]

        return play

    (_, expected), (drawn, found) = subject(scene(True)), subject(scene(False))
    assert found == expected
    assert drawn <= 12


def test_a_frozen_picture_shows_the_same_pixels_again(subject: Callable[[Scene], Any]) -> None:
    async def scene(camera: ObjectCamera) -> None:
        camera.inject("freeze")
        a, b = await camera.capture(2, HERE, "x", camera.clock.now())
        camera.inject("clear")
        c, d = await camera.capture(2, HERE, "x", camera.clock.now())
        assert all(f.board is not None for f in (a, b, c, d))
        assert np.array_equal(a.board.corners, b.board.corners)
        assert not np.array_equal(c.board.corners, d.board.corners)

    subject(scene)


def test_a_lost_board_comes_back_after_the_time_given(subject: Callable[[Scene], Any]) -> None:
    async def scene(camera: ObjectCamera) -> None:
        camera.inject("lost-board", duration_s=1.0)
        (gone,) = await camera.capture(1, HERE, "x", camera.clock.now())
        await camera.clock.sleep(1.0)
        (back,) = await camera.capture(1, HERE, "x", camera.clock.now())
        assert gone.board is None
        assert back.board is not None

    subject(scene)


def test_frames_show_their_exposure_time_and_arrive_later(subject: Callable[[Scene], Any]) -> None:
    async def scene(camera: ObjectCamera) -> None:
        arrivals: list[tuple[float, float]] = []
        unsubscribe = camera.frames.subscribe(lambda s: arrivals.append((s.t, camera.clock.now())))
        await camera.clock.sleep(0.55)
        unsubscribe()
        delays = [now - t for t, now in arrivals]
        assert len(delays) >= 4
        assert delays == pytest.approx([0.034] * len(delays), abs=1e-6)

    subject(scene)


def test_the_camera_is_refused_while_it_boots_and_has_its_new_serial_then(
    subject: Callable[[Scene], Any],
) -> None:
    async def scene(camera: ObjectCamera) -> None:
        camera.inject("reboot", serial="99990000077", boot_s=2.0)
        with pytest.raises(CellError, match="refuses"):
            await camera.open()
        await camera.clock.sleep(2.0)
        await camera.open()
        assert (await camera.identify()).serial == "99990000077"

    subject(scene)


@pytest.mark.parametrize(
    ("target", "first", "second", "count"),
    [
        (
            {"type": "charuco", "squares_x": 4, "squares_y": 3, "square_m": 0.02},
            [0.02, 0.02],
            [0.04, 0.02],
            6,
        ),
        ({"type": "chessboard", "columns": 4, "rows": 3, "square_m": 0.02}, [0, 0], [0.02, 0], 12),
        ({"type": "circle-grid", "columns": 4, "rows": 3, "spacing_m": 0.03}, [0, 0], [0.03, 0], 12),
        ({"type": "aruco-marker", "id": 3, "size_m": 0.1}, [-0.05, 0.05], [0.05, 0.05], 4),
        ({"type": "points", "points": [[1, 2, 3], [4, 5, 6]]}, [1, 2], [4, 5], 2),
    ],
)
def test_target_points_lie_as_the_formats_say(
    target: dict[str, Any], first: list[float], second: list[float], count: int
) -> None:
    points = target_points(target)
    assert points.shape == (count, 3)
    assert points[0, :2] == pytest.approx(first)
    assert points[1, :2] == pytest.approx(second)


def test_an_unknown_target_type_is_named() -> None:
    with pytest.raises(CellError, match="hologram"):
        target_points({"type": "hologram"})


def with_autofocus(folder: Path) -> str:
    path = folder / "autofocus.toml"
    path.write_text(
        ideal_text("hand_eye").replace("period_s = 0.1\n", "period_s = 0.1\nautofocus = true\n"), "utf-8"
    )
    return str(path)


def test_a_lens_that_an_autofocus_moves_ends_the_link_at_the_first_frame_that_shows_it(
    tmp_path: Path,
) -> None:
    async def scene() -> None:
        camera = ObjectCamera(
            "camera", ObjectCamera.Config(scenario=with_autofocus(tmp_path)), VirtualClock()
        )
        await camera.open()
        await camera.set_target(camera.world.target)
        begin = camera.clock.now()
        first = (await camera.capture(1, HERE, "x", begin))[0]
        lost = await camera.wait_lost()
        assert isinstance(lost, CellError)
        assert lost.name == "CAMERA_LENS_MOVED"
        assert camera.clock.now() - begin < 2.0, "of 7 s, in which it is in 17 places"
        assert first.board is not None
        await camera.open()  # and the next link stays as it finds the lens
        assert camera.lost is None
        await camera.close()
        await camera.clock.sleep(3.0)

    run_virtual(scene())


@pytest.mark.usefixtures("no_report")
def test_a_job_whose_camera_focuses_by_itself_ends_by_that_name(tmp_path: Path) -> None:
    async def scene() -> None:
        async with open_cell(write_config(tmp_path, with_autofocus(tmp_path))) as cell:
            end = await cell.finished(await cell.start())
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "CAMERA_LENS_MOVED")

    run_virtual(scene())


def test_the_picture_breathes_with_the_lens(tmp_path: Path) -> None:
    async def scene() -> None:
        camera = ObjectCamera(
            "camera", ObjectCamera.Config(scenario=with_autofocus(tmp_path)), VirtualClock()
        )
        board, K = camera.world.target, camera.world.camera.K
        seen = [camera.head.view(7.0 * turn, 0, board) for turn in (0.25, 0.75)]  # both ends of its range
        near, far = (np.linalg.norm(one.corners - K[2:], axis=1).mean() for one in seen if one is not None)
        assert near / far == pytest.approx(1.0027, abs=5e-5)

    run_virtual(scene())
