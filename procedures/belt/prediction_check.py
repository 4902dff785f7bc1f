"""How well a run of picking could predict where its items would be, from the data set that it left."""

from pathlib import Path

from cell.formats.result import Empty
from procedures.belt.result import BeltTrackingResult, InterceptResult
from procedures.belt.solve.solver import solve_intercept


def with_predictions(picked: BeltTrackingResult, path: Path) -> BeltTrackingResult:
    """``picked`` with residuals, held-out errors and what the camera leaves open as ``cellward solve
    intercept`` has them for the ``intercept.json`` at ``path``: the part of a run's result that its data give
    again. Raises ``InputError`` as that does."""
    solved = solve_intercept(path, calls=1)
    if isinstance(solved, InterceptResult):
        answer = picked.result.changed(camera_95_m=solved.uncertainty.camera_95_m)
        return picked.changed(result=answer, residuals=solved.residuals, heldout=solved.heldout)
    return picked.changed(residuals=Empty(), heldout=Empty())
