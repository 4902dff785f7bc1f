"""``cellward pose save`` against a stand-in engine: one line of cell.toml changes and nothing else."""

import stat
import tomllib
from typing import Any

import pytest

from daemon.cli.poses import with_pose
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.control_harness import RecordingEngine, served

Q = [0.1, -1.5707963267948966, 1.2, 0.0, -0.5, 3.0]
LINE = "above = [0.1, -1.570796, 1.2, 0.0, -0.5, 3.0]"
HEADING = "\n# -- the page --\n\n# on this computer alone\n"
POSES = (
    "\n[poses]           # always joints\nhome = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]   # upright\n"
    + HEADING
    + "[http]\n"
)


class StandingArm(RecordingEngine):
    moving = False

    def joints(self) -> dict[str, Any]:
        return {"q": Q, "moving": self.moving}


def test_where_the_arm_stands_is_written_by_its_name(cell: CellOnDisk, subject: CommandLine) -> None:
    before = tomllib.loads(cell.config.read_text())
    cell.config.chmod(0o640)
    with served(cell.socket, StandingArm()):
        done = subject("pose", "save", "above")
    assert (done.code, done.out) == (0, LINE + "\n")
    assert "from its next start on" in done.err
    after = tomllib.loads(cell.config.read_text())
    assert after.pop("poses")["above"] == [0.1, -1.570796, 1.2, 0.0, -0.5, 3.0]
    before.pop("poses", None)
    assert after == before
    assert stat.S_IMODE(cell.config.stat().st_mode) == 0o640


def test_a_pose_that_there_is_stays_unless_it_is_to_be_replaced(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    with served(cell.socket, StandingArm()):
        subject("pose", "save", "above")
        kept = cell.config.read_text()
        refused = subject("pose", "save", "above")
        assert (refused.code, cell.config.read_text()) == (2, kept)
        assert "--replace overwrites it" in refused.err
        assert subject("pose", "save", "above", "--replace").code == 0


def test_an_arm_that_moves_and_a_name_that_is_none_are_refused(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    before, engine = cell.config.read_text(), StandingArm()
    engine.moving = True
    with served(cell.socket, engine):
        moving, named = subject("pose", "save", "above"), subject("pose", "save", "a pose")
    assert (moving.code, named.code) == (4, 2)
    assert "when it stands" in moving.err
    assert cell.config.read_text() == before


def test_comments_and_other_sections_stay_as_they_are() -> None:
    text = with_pose(POSES, "above", Q, replace=False)
    assert text == POSES.replace("# upright\n", f"# upright\nabove = {Q}\n")
    assert with_pose(POSES, "home", Q, replace=True) == POSES.replace(str([0.0] * 6), str(Q))


def test_a_file_with_the_line_ends_of_windows_keeps_them() -> None:
    text = with_pose(POSES.replace("\n", "\r\n"), "above", Q, replace=False)
    assert text.count("\n") == text.count("\r\n") == POSES.count("\n") + 1


def test_a_file_without_poses_gets_the_section() -> None:
    assert tomllib.loads(with_pose("schema = 1\n", "above", Q, replace=False))["poses"]["above"] == Q


def test_joints_with_which_the_daemon_would_not_start_are_refused(
    cell: CellOnDisk, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = cell.config.read_text()
    monkeypatch.setattr(StandingArm, "joints", lambda _: {"q": [6.2999, *Q[1:]], "moving": False})
    with served(cell.socket, StandingArm()):
        done = subject("pose", "save", "above")
    assert done.code == 2
    assert "poses.above[0]: 6.2999 rad is beyond the joint's range" in done.err
    assert "is left as it was" in done.err
    assert cell.config.read_text() == before
    assert [path.name for path in cell.config.parent.iterdir() if path.name.startswith(".")] == []


def test_a_file_of_somebody_else_is_not_replaced(
    cell: CellOnDisk, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = cell.config.read_text()
    monkeypatch.setattr("os.geteuid", lambda: 54321)
    with served(cell.socket, StandingArm()):
        done = subject("pose", "save", "above")
    assert done.code == 4
    assert LINE in done.err
    assert cell.config.read_text() == before
