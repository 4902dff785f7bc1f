"""How well a run of picking could predict where its items would be, from the data set that it left."""

from pathlib import Path
from typing import Any

from procedures.belt.solve.solver import solve_intercept

KEYS = ("residuals", "heldout")


def predicted(path: Path) -> dict[str, Any]:
    """Residuals and held-out errors as ``cellward solve intercept`` has them for the ``intercept.json`` at
    ``path``: the part of a run's result that its data give again. Raises ``InputError`` as that does."""
    solved = solve_intercept(path)
    return {key: solved[key] for key in KEYS}
