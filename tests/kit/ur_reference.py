"""UR's published kinematics as a library computes them that shares no code with this project."""

import json
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from cell.poses import Array

_STORED = Path(__file__).with_name("ur_poses.json")


def independent_library() -> ModuleType:
    """The library itself; skips the test on a Python for which it has no wheel."""
    return pytest.importorskip("ur_analytic_ik", reason="ur-analytic-ik has wheels for Python 3.11 alone")


def independent_poses(model: str) -> tuple[Array, Array]:
    """Joints (n, 6) and the poses (n, 4, 4) that the library gives for them, stored for every Python."""
    document = _stored()
    rows = np.array(document["T_base_flange"][model])
    last = np.broadcast_to([[[0.0, 0.0, 0.0, 1.0]]], (len(rows), 1, 4))
    return np.array(document["q"]), np.concatenate([rows, last], axis=1)


def models_of_the_library() -> list[str]:
    """It is older than some arms."""
    return sorted(_stored()["T_base_flange"])


@cache
def _stored() -> Any:
    return json.loads(_STORED.read_text("utf-8"))
