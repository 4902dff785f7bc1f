"""A whole run on the wire, recorded, replays through the drivers to the same result.

Twin and daemon record as processes; the replay is in this process, on virtual time, with no twin at all.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.hiccups import SCENES
from cell.poses import Array
from tests.kit.replayed import Session, compared, record, replay
from tests.kit.wire_cell import BRISK

pytestmark = [pytest.mark.wire, pytest.mark.alone, pytest.mark.slow]
HOST = "127.0.78.1"


def once_and_again(job: str, folder: Path, **keys: Any) -> tuple[Session, Session]:
    """``keys``: other numbers than the bench has, for a job that takes less time."""
    scene = replace(SCENES[job], keys=SCENES[job].keys | keys)
    session = record(folder / "r", HOST, scene.text, [*scene.before, job], scene.first)
    again = replay(session, folder / "p")
    assert session.outcomes == again.outcomes == ["complete"] * len(session.outcomes)
    assert [r["verdict"] for r in session.results] == [r["verdict"] for r in again.results]
    return session, again


def test_a_cameras_calibration_replays_to_the_same_pose(tmp_path: Path) -> None:
    short = {"poses_per_placement": 6, "frames_per_pose": 2, "settle_s": 0.05}
    session, again = once_and_again("cone-capture", tmp_path, **short, **BRISK)
    told = {c.protocol for c in session.recording.connections}
    assert told >= {"rtde", "primary", "dashboard", "motion-child", "vision-child", "modbus"}
    poses = [np.array(s.results[0]["result"]["T_flange_camera"]) for s in (session, again)]
    np.testing.assert_allclose(poses[0], poses[1], rtol=0.0, atol=1e-9)
    figures, _, most, where = compared(session.results[0], again.results[0])
    assert figures > 500
    assert most < 0.05, f"{where}: more than what chance leaves of draws from a covariance"


@pytest.mark.soak
def test_crossed_beams_replay_to_the_same_tool_point(tmp_path: Path) -> None:
    """Where the search halves a height, a reading at the edge of its window may change a step by microns."""
    session, again = once_and_again("laser-reference", tmp_path)

    def hits(one: Session) -> Array:
        return np.array([one.results[0]["result"]["hits"][beam] for beam in ("xs", "ys")])

    stated = session.results[0]["uncertainty"]["U_point_m"]
    assert np.abs(hits(session) - hits(again)).max() < 0.5 * stated
    assert len(session.results[0]["result"]["passes"]) == len(again.results[0]["result"]["passes"])
