"""A disk that runs low is told before it is full: in the status, in the log, and to the PLC."""

import asyncio
import logging
from collections import namedtuple
from pathlib import Path

import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.devices import Intrinsics
from daemon.cli.status_text import status_text
from daemon.config import init_text, load_config
from daemon.disk_space import (
    LEAST_BYTES,
    LOOK_S,
    PIXEL_BYTES,
    DiskSpace,
    capture_bytes,
    free_bytes,
    low_limit,
)
from drivers.oak.files import write_png
from fakes.frames.plates import make_plate
from fakes.frames.render import Optics, Renderer
from fakes.object import VirtualClock, run_virtual

CHECK = """[job.eye-to-hand-check]
target = "board"
T_marker_flange = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
frames_per_pose = 20
targets = [[0.0, 0.0, 0.6, 0.0, 0.0, 0.0]]
"""
THOROUGH = """[recipe.thorough]
job = "cone-capture"
placements = 8
"""
Usage = namedtuple("Usage", "total used free")


def test_a_disk_that_runs_low_is_told_once_and_so_is_its_recovery(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    free = [LEAST_BYTES + 1, LEAST_BYTES - 1, 10**8, OSError(5, "I/O error"), LEAST_BYTES]
    looked = iter(free)

    def usage(_: Path) -> Usage:
        found = next(looked)
        if isinstance(found, OSError):
            raise found
        return Usage(0, 0, found)

    monkeypatch.setattr("shutil.disk_usage", usage)

    async def main() -> list[str | None]:
        clock = VirtualClock()
        subject = DiskSpace(tmp_path, clock)
        assert subject.status()["warning"] is None
        task = asyncio.create_task(subject.watch())
        told = []
        for _ in free:
            await clock.sleep(LOOK_S / 2)
            told.append(subject.status()["warning"])
            await clock.sleep(LOOK_S / 2)
        task.cancel()
        return told

    with caplog.at_level(logging.INFO, "cellward.health"):
        told = run_virtual(main())
    assert [warning is not None for warning in told] == [False, True, True, False, False]
    assert "0.1 GB are free, less than 2.0 GB" in (told[2] or "")
    assert [r.levelname for r in caplog.records] == ["WARNING", "ERROR", "INFO"]
    assert "free again" in caplog.records[2].getMessage()


def test_the_status_says_it_in_words() -> None:
    status = {"cell": "c", "packml": "IDLE", "devices": {}, "disk": {"warning": "1.2 GB are free"}}
    assert "disk      1.2 GB are free" in status_text(status)
    assert "disk" not in status_text({**status, "disk": {}})


def test_a_folder_that_is_not_made_yet_is_judged_by_what_exists_of_its_path(tmp_path: Path) -> None:
    assert free_bytes(tmp_path / "not" / "yet") > 0


@pytest.mark.parametrize(
    ("old", "new", "frames", "limit_gb"),
    [
        ("", "", 300, 2.0),
        ("placements = 3\n", "", 1000, 3.89),
        ("[device.camera]\n", "[device.camera]\nwidth = 1920\nheight = 1200\n", 675, 2.63),
        ("[job.cone-capture]\n", CHECK + "[job.cone-capture]\n", 1240, 4.83),
        ("[job.cone-capture]\n", THOROUGH + "[job.cone-capture]\n", 800, 3.11),
    ],
    ids=[
        "the example",
        "ten placements by default",
        "a camera of 1920 x 1200",
        "a check of a fixed camera",
        "a recipe",
    ],
)
def test_the_limit_is_twice_what_the_largest_configured_capture_writes(
    tmp_path: Path, old: str, new: str, frames: int, limit_gb: float
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(init_text().replace(old, new, 1))
    config = load_config(path)
    assert capture_bytes(config) == pytest.approx(frames * 1.946e6, rel=0.01)
    assert low_limit(config) == pytest.approx(limit_gb * 1e9, rel=0.01)


def test_a_frame_on_disk_is_as_large_as_the_limit_takes_it_to_be(tmp_path: Path) -> None:
    target = {"type": "chessboard", "columns": 9, "rows": 6, "square_m": 0.025}
    renderer = Renderer(Optics(Intrinsics(1280, 800, (900.0, 902.0, 645.2, 398.7))), make_plate(target))
    facing = RigidTransform.from_components([-0.1, -0.06, 0.5], Rotation.from_rotvec([0.1, 0.2, 0.0]))
    frame = renderer.render([facing])
    write_png(tmp_path / "colour.png", frame.colour)
    write_png(tmp_path / "depth.png", frame.depth)
    size = sum(file.stat().st_size for file in tmp_path.iterdir())
    assert size == pytest.approx(PIXEL_BYTES * 1280 * 800, rel=0.05)
