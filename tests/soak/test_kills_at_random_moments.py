"""Every kind of kill at ten random moments of a running capture; run by ``make soak``."""

import random
from pathlib import Path

import pytest

from tests.kit.kills import KINDS, short_capture, survive
from tests.kit.wire_cell import wire_cell

pytestmark = [pytest.mark.soak, pytest.mark.wire]


@pytest.mark.parametrize("kind", KINDS)
def test_ten_kills_at_random_moments(kind: str, tmp_path: Path) -> None:
    rng = random.Random(kind)
    rests = []
    with wire_cell(tmp_path, "127.0.0.61", short_capture(6)) as cell:
        for attempt in range(10):
            moment = rng.uniform(0.0, 10.0)
            rest = survive(cell, kind, moment)
            rests.append(rest)
            print(f"{kind}, kill {attempt + 1} after {moment:.2f} s of motion: at rest in {rest:.3f} s")
    print(f"{kind}: standstill within {max(rests):.3f} s in all {len(rests)} cases")
