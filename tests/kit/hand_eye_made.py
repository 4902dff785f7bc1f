"""What tests of whole captures take as given where they are about the run: an answer, and one plan a view."""

from dataclasses import replace

import numpy as np
import pytest

from procedures.hand_eye.plan import PlanRequest, plan_placement
from tests.kit.object_cell import PLANNERS
from tests.kit.remembered import remembered
from tests.kit.whole_results import made

ANSWER = made(
    {
        "schema": "cellward.result/1",
        "kind": "hand-eye",
        "verdict": "pass",
        "reasons": [],
        "result": {"T_flange_camera": [0.0, -0.08, 0.05, 0.0, 0.0, 0.0]},
        "uncertainty": {},
    }
)


def _less_noise(request: PlanRequest) -> PlanRequest:
    """The board's place and size in the picture, px: views that differ by the pixels' noise are one."""
    corners = np.array(request.view.corners)
    shape = [np.round(corners.mean(axis=0)).tolist(), np.round(corners.std(axis=0)).tolist()]
    return replace(request, view=replace(request.view, corners=shape))


_plan_for_view = remembered(plan_placement, alike=_less_noise)


@pytest.fixture
def quick_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is solved, and which poses are best, does not matter; what becomes of the run does."""
    solve_quickly(monkeypatch)


def solve_quickly(patch: pytest.MonkeyPatch) -> None:
    """See :func:`quick_solver`."""
    patch.setattr("procedures.hand_eye.verdict.solve_hand_eye", lambda path, **_: ANSWER)
    patch.setitem(PLANNERS, plan_placement, _plan_for_view)
