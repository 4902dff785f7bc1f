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
from tests.kit.picks_compared import compare_picks
from tests.kit.replayed import Session, as_replayable, compared, record, replay
from tests.kit.wire_cell import BRISK

pytestmark = [pytest.mark.wire, pytest.mark.alone, pytest.mark.slow]
HOST = "127.0.78.1"
FINISH_S = 14.0  # of a run that goes on until it is finished: at least three picks


def once_and_again(job: str, folder: Path, **keys: Any) -> tuple[Session, Session]:
    """``keys``: other numbers than the bench has, for a job that takes less time."""
    scene = replace(SCENES[job], keys=SCENES[job].keys | keys)
    limit = None if scene.finish_after_s is None else FINISH_S
    text = as_replayable(scene.text)
    session = record(folder / "r", HOST, text, [*scene.before, job], scene.first, limit)
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


def test_picking_from_a_belt_replays_to_the_same_items_and_contacts(tmp_path: Path) -> None:
    """What is sent depends on the instant of each decision, and these are the recording's.

    Then no set-point differs at all. One count more at the beginning of the record, or a time-stamp that is
    35 us off, is 0.08 mm at a contact, by plans that come to another choice on the way: a machine that pauses
    may once read what came together in another order. Without the recording's instants contacts differ by
    3 mm and 20 ms, and an item is lost.
    """
    quarter = {"width": 640, "height": 400, "K": "[401.2, 400.85, 322.1, 198.4]"}  # of the time to draw it
    session, again = once_and_again("belt-tracking", tmp_path, **quarter)
    subject = compare_picks(session.state, again.state)
    assert subject.ends[0] == subject.ends[1]
    assert subject.contacts[0] == subject.contacts[1] >= 3
    assert subject.contact_s < 0.001
    assert subject.contact_m < 2e-4
    assert subject.common > 0.98 * max(subject.steps)


def test_targets_of_an_arm_that_is_read_replay_to_the_same_arrivals(tmp_path: Path) -> None:
    """What the job asks the tracker comes between the polls of the driver, as it did."""
    session, again = once_and_again(
        "corrected-targets", tmp_path, targets="[[1.7, 0.4, 0.6, 0.3], [1.5, -0.7, 0.9, -0.8]]"
    )
    figures, unequal, most, where = compared(session.results[0], again.results[0])
    assert figures > 90
    assert most < 1e-6, f"{where}, and {unequal} figures in all"


@pytest.mark.soak
def test_crossed_beams_replay_to_the_same_tool_point(tmp_path: Path) -> None:
    """Where the search halves a height, a reading at the edge of its window may change a step by microns."""
    session, again = once_and_again("laser-reference", tmp_path)

    def hits(one: Session) -> Array:
        return np.array([one.results[0]["result"]["hits"][beam] for beam in ("xs", "ys")])

    stated = session.results[0]["uncertainty"]["U_point_m"]
    assert np.abs(hits(session) - hits(again)).max() < 0.5 * stated
    assert len(session.results[0]["result"]["passes"]) == len(again.results[0]["result"]["passes"])


@pytest.mark.soak
def test_a_corrected_tool_replays_to_the_same_frame(tmp_path: Path) -> None:
    session, again = once_and_again("laser-update", tmp_path)
    frames = [one.results[-1]["result"]["T_flange_tool"] for one in (session, again)]
    stated = session.results[-1]["uncertainty"]["U_point_m"]
    assert np.abs(np.subtract(*frames))[:3].max() < 0.5 * stated
    assert all(one.results[-1]["inputs"]["update"]["committed"] for one in (session, again))
