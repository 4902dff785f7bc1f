"""Each kind of kill once, on the way to the second of three poses; the soak does all of them ten times at
random moments."""

from collections.abc import Iterator

import pytest

from tests.kit.kills import KINDS, short_capture, survive
from tests.kit.wire_cell import WireCell, wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.alone, pytest.mark.slow, pytest.mark.restarts_children]

BRISK = {"speed_m_s": 0.5, "accel_m_s2": 2.0, "joint_speed_rad_s": "1.6\njoint_accel_rad_s2 = 6.0"}

# After a daemon that began anew, and after one that went on; the soak takes up a run after every kind.
TAKEN_UP = {"daemon-killed", "arm-child-killed"}


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WireCell]:
    with wire_cell(tmp_path_factory.mktemp("cell"), "127.0.0.60", short_capture(3, **BRISK)) as cell:
        yield cell


@pytest.mark.parametrize("kind", KINDS)
def test_the_arm_rests_and_nothing_finished_is_lost_after(kind: str, subject: WireCell) -> None:
    survive(subject, kind, moment_s=0.1, after_poses=1, take_up=kind in TAKEN_UP)
