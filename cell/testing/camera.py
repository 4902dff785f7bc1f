"""What every camera promises, on every face: stamped exposures, corners where the board truly is."""

import asyncio
import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.devices import DepthCamera, Frame, Intrinsics
from cell.errors import CellError
from cell.poses import Array, to_pose6
from cell.testing.bench import Bench, Rig, known
from cell.testing.device import DeviceContract

CORNER_TOLERANCE_PX = 0.3


class BoardScene(Protocol):
    """How the board lies at one moment; the pose is None while it is away."""

    @property
    def T_camera_target(self) -> RigidTransform | None: ...
    @property
    def placement(self) -> int: ...


class Operator(Protocol):
    """Who handles the board."""

    def confirm(self, placement: int, t: float) -> None:
        """Lay it where placement ``placement`` has it, from ``t`` on."""
        ...

    def remove(self, t: float) -> None: ...
    def put_back(self, t: float) -> None: ...


class BoardWorld(Protocol):
    """What the camera looks at: a ChArUco board with 54 corners, wholly in view at placements 0 and 2."""

    @property
    def target(self) -> dict[str, Any]: ...
    @property
    def intrinsics(self) -> Intrinsics: ...
    @property
    def operator(self) -> Operator: ...
    def scene(self, t: float) -> BoardScene: ...


@dataclass
class CameraRig(Rig[DepthCamera]):
    """``world`` is what the camera looks at, for the truth; its operator moves the board."""

    world: BoardWorld | None = field(default=None, kw_only=True)

    @property
    def seen(self) -> BoardWorld:
        return known(self.world, "world")


def opencv_corners(rig: CameraRig, frame: Frame) -> Array:
    """Where OpenCV's own board and projection put the corners."""
    t = rig.seen.target
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, t["dictionary"]))
    board = cv2.aruco.CharucoBoard((t["squares_x"], t["squares_y"]), t["square_m"], t["marker_m"], dictionary)
    T_camera_target = rig.seen.scene(frame.t_exposure).T_camera_target
    assert T_camera_target is not None
    pose = to_pose6(T_camera_target)
    uv, _ = cv2.projectPoints(
        board.getChessboardCorners(),
        pose[3:],
        pose[:3],
        frame.intrinsics.matrix,
        np.array(frame.intrinsics.dist),
    )
    return np.asarray(uv, np.float64).reshape(-1, 2)


def assert_same_intrinsics(found: Intrinsics, truth: Intrinsics) -> None:
    """The same to the last bit of single precision, in which an OAK's calibration is stored."""
    assert (found.width, found.height) == (truth.width, truth.height)
    assert np.array_equal(np.array(found.K, np.float32), np.array(truth.K, np.float32))
    assert np.array_equal(np.array(found.dist, np.float32), np.array(truth.dist, np.float32))


class CameraContract(DeviceContract[CameraRig]):
    """Exposures are stamped, and corners lie where the board truly is."""

    def test_captured_frames_are_exposed_wholly_after_the_moment_asked(
        self, subject: Bench[CameraRig], tmp_path: Path
    ) -> None:
        async def scene(rig: CameraRig) -> None:
            after = rig.clock.now()
            frames = await rig.device.capture(3, tmp_path, "pose", after)
            assert len(frames) == 3
            assert all(f.t_exposure - f.exposure_s / 2 >= after for f in frames)
            assert all(a.seq < b.seq and a.t_exposure < b.t_exposure for a, b in itertools.pairwise(frames))
            assert frames[-1].t_exposure <= rig.clock.now()

        subject(scene)

    def test_a_capture_into_a_folder_that_is_not_there_fails_by_name(
        self, subject: Bench[CameraRig], tmp_path: Path
    ) -> None:
        async def scene(rig: CameraRig) -> None:
            with pytest.raises(CellError) as failed:
                await rig.device.capture(1, tmp_path / "none", "pose", rig.clock.now())
            assert failed.value.name == "DISK_FAILED"

        subject(scene)

    def test_the_board_is_found_where_it_truly_is_at_exposure(
        self, subject: Bench[CameraRig], tmp_path: Path
    ) -> None:
        subject.needs("truth")

        async def scene(rig: CameraRig) -> None:
            (frame,) = await rig.device.capture(1, tmp_path, "pose", rig.clock.now())
            assert frame.board is not None
            assert len(frame.board.ids) == 54
            truth = opencv_corners(rig, frame)[frame.board.ids]
            off = np.linalg.norm(frame.board.corners - truth, axis=1)
            assert np.sqrt(np.mean(off**2)) < CORNER_TOLERANCE_PX
            assert_same_intrinsics(frame.intrinsics, rig.seen.intrinsics)
            assert 20 < frame.board.mean_grey < 235

        subject(scene)

    def test_nothing_is_found_when_nothing_or_another_board_is_looked_for(
        self, subject: Bench[CameraRig], tmp_path: Path
    ) -> None:
        subject.needs("truth")

        async def scene(rig: CameraRig) -> None:
            for target in (None, {**rig.seen.target, "dictionary": "DICT_6X6_250"}):
                await rig.device.set_target(target)
                await rig.clock.sleep(0.3)
                (frame,) = await rig.device.capture(1, tmp_path, "none", rig.clock.now())
                assert frame.board is None or len(frame.board.ids) == 0

        subject(scene)

    def test_the_operator_moves_the_board_and_the_camera_sees_it_there(
        self, subject: Bench[CameraRig], tmp_path: Path
    ) -> None:
        subject.needs("truth")

        async def scene(rig: CameraRig) -> None:
            rig.seen.operator.confirm(2, rig.clock.now())
            await rig.clock.sleep(0.2)
            (frame,) = await rig.device.capture(1, tmp_path, "moved", rig.clock.now())
            assert frame.board is not None
            assert rig.seen.scene(frame.t_exposure).placement == 2
            off = frame.board.corners - opencv_corners(rig, frame)[frame.board.ids]
            assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < CORNER_TOLERANCE_PX

        subject(scene)

    def test_a_board_that_is_taken_away_is_not_seen_until_it_is_back(
        self, subject: Bench[CameraRig], tmp_path: Path
    ) -> None:
        subject.needs("truth")

        async def scene(rig: CameraRig) -> None:
            rig.seen.operator.remove(rig.clock.now())
            await rig.clock.sleep(0.2)
            (gone,) = await rig.device.capture(1, tmp_path, "gone", rig.clock.now())
            rig.seen.operator.put_back(rig.clock.now())
            await rig.clock.sleep(0.2)
            (back,) = await rig.device.capture(1, tmp_path, "back", rig.clock.now())
            assert gone.board is None or len(gone.board.ids) == 0
            assert back.board is not None

        subject(scene)

    @pytest.mark.parametrize("fault", ["drop", "silence"])
    def test_frames_that_stop_end_a_capture_with_device_lost_and_the_camera_opens_again(
        self, subject: Bench[CameraRig], fault: str, tmp_path: Path
    ) -> None:
        subject.needs(fault)

        async def scene(rig: CameraRig) -> None:
            capture = asyncio.create_task(rig.device.capture(200, tmp_path, "cut", rig.clock.now()))
            await rig.clock.sleep(0.3)
            await rig.inject(fault)
            async with asyncio.timeout(10.0):
                with pytest.raises(CellError) as failed:
                    await capture
                assert failed.value.name == "DEVICE_LOST"
                assert getattr(await rig.device.wait_lost(), "name", None) == "DEVICE_LOST"
            await rig.device.close()
            await rig.inject("clear")
            await rig.device.open()
            await rig.device.wait_fresh(5.0)

        subject(scene)
