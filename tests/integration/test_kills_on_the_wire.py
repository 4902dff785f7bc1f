"""Each kind of kill once, on a short plan; the soak does all of them ten times at random moments."""

from pathlib import Path

import pytest

from tests.kills import KINDS, survive
from tests.wire_cell import wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.slow]


@pytest.mark.parametrize("kind", KINDS)
def test_the_arm_rests_and_the_run_can_be_taken_up_after(kind: str, tmp_path: Path) -> None:
    with wire_cell(tmp_path, "127.0.0.60", poses=3) as cell:
        survive(cell, kind, moment_s=1.0)
