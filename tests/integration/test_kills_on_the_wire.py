"""Each kind of kill once, on the way to the second of three poses; the soak does all of them ten times at
random moments."""

from collections.abc import Iterator

import pytest

from tests.kit.kills import KINDS, short_capture, survive
from tests.kit.wire_cell import BRISK, WireCell, wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.alone, pytest.mark.slow, pytest.mark.restarts_children]

# After a daemon that began anew, and after one that went on; the soak takes up a run after every kind.
TAKEN_UP = {"daemon-killed", "arm-child-killed"}


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WireCell]:
    scenario = short_capture(3, **BRISK, settle_s=0.05)
    with wire_cell(tmp_path_factory.mktemp("cell"), "127.0.0.60", scenario) as cell:
        yield cell


@pytest.mark.parametrize("kind", KINDS)
def test_the_arm_rests_and_nothing_finished_is_lost_after(kind: str, subject: WireCell) -> None:
    survive(subject, kind, moment_s=0.1, after_poses=1, take_up=kind in TAKEN_UP)
