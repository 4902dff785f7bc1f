"""Where items are put down: one place, or those of a grid, one after the other."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from calibration.belt.pursuit import FixedPoint, PursuitState
from cell.errors import CellError
from cell.guard import MotionGuard
from cell.poses import Array
from procedures.belt.config import BeltTrackingConfig, PlaceGrid
from procedures.belt.motion.tool_joints import ToolJoints


def grid_points(grid: PlaceGrid, tool: ToolJoints, first: Array) -> Array:
    """(n, 4) the tool at each place of ``grid`` in the order in which they are filled, the ``first`` (4,)
    before all others; column by column, then row by row, then layer by layer upwards. The grid is level, and
    the tool keeps its turn."""
    heading = tool.heading() + float(first[3])
    x = np.array([np.cos(heading), np.sin(heading), 0.0, 0.0])
    y = np.array([x[1], -x[0], 0.0, 0.0])  # of a tool that points down
    along = {"x": x, "-x": -x, "y": y, "-y": -y}
    column, row = grid.column_pitch_m * along[grid.columns_along], grid.row_pitch_m * along[grid.rows_along]
    level = [r * row + c * column for r in range(grid.rows) for c in range(grid.columns)]
    up = np.array([0.0, 0.0, grid.layer_m or 0.0, 0.0])
    return np.array([first + layer * up + there for layer in range(grid.layers) for there in level])


class Places:
    """Counts the places that are filled, from ``first_place`` on. A place without a grid is never full.

    ``q_first`` (6,) are the joints at the first place; ``tell`` hears which place of a grid is next.
    """

    def __init__(
        self,
        config: BeltTrackingConfig,
        tool: ToolJoints,
        q_first: Array,
        tell: Callable[[int], None] = lambda number: None,
    ) -> None:
        first = tool.state(q_first).p
        self._grid, self._tool, self._q_first = config.place_grid, tool, q_first
        self._points = first[None] if self._grid is None else grid_points(self._grid, tool, first)
        self._up = np.array([0.0, 0.0, config.above_m, 0.0])
        self._look_above_m = config.look_above_m
        self._next = config.first_place - 1
        self.filled = self.renewed = 0
        self._tell = tell
        self._say_next()

    def __len__(self) -> int:
        return len(self._points)

    @property
    def is_grid(self) -> bool:
        return self._grid is not None

    @property
    def full(self) -> bool:
        """Whether there is no place left."""
        return self._next >= len(self._points)

    @property
    def number(self) -> int:
        """The next place, counted from 1; 0 when all are filled."""
        return 0 if self.full else self._next + 1

    @property
    def here(self) -> FixedPoint:
        """The next place."""
        return FixedPoint(self._points[self._next])

    def _say_next(self) -> None:
        """Say which place is next."""
        if self._grid is not None:
            self._tell(self.number)

    def take(self) -> None:
        """The gripper is told to let go of an item at the next place: it counts as filled, whatever comes."""
        if self._grid is not None:
            self._next += 1
            self.filled += 1
            self._say_next()

    def renew(self) -> None:
        """Somebody says that all places are empty."""
        self._next, self.renewed = 0, self.renewed + 1
        self._say_next()

    def words(self, number: int) -> str:
        """Of place ``number``, counted from 1."""
        if self._grid is None:
            return "the place"
        row, column = divmod(number - 1, self._grid.columns)
        layer, row = divmod(row, self._grid.rows)
        which = f"layer {layer + 1}, " if self._grid.layers > 1 else ""
        return f"place {number} of {len(self)} ({which}row {row + 1}, column {column + 1})"

    @property
    def level_m(self) -> float:
        """Height of the tool on the level ways above the layer that is filled, in the base."""
        return float(self._points[min(self._next, len(self) - 1), 2] + self._up[2])

    @property
    def top_level_m(self) -> float:
        """The same above the uppermost layer."""
        return float(self._points[-1, 2] + self._up[2])

    def is_over(self, p: Array) -> bool:
        """Whether the tool at ``p`` (4,) is over a grid, or within a pitch beside it."""
        if self._grid is None:
            return False
        beside = max(self._grid.column_pitch_m, self._grid.row_pitch_m)
        return bool(np.linalg.norm(self._points[:, :2] - p[:2], axis=1).min() < beside)

    def looks_down(self, step_m: float) -> list[PursuitState]:
        """The tool at rest above the next place, where ``place_clear`` is looked at on the way down from
        there (every ``step_m``, the last time at ``look_above_m``), and in the place."""
        above_m = float(self._up[2])
        heights = np.arange(above_m, self._look_above_m, -step_m)
        heights = np.unique(np.round([above_m, *heights, self._look_above_m, 0.0], 6))[::-1]
        at, up = self.here.p, np.array([0.0, 0.0, 1.0, 0.0])
        return [PursuitState.still(at + height * up) for height in heights]

    def joints_over(self) -> Array:
        """Joints (6,) above the next place, on the branch of the first one."""
        return self._tool.walked(self._points[0] + self._up, self.here.p + self._up, self._over_first())

    def _over_first(self) -> Array:
        return self._tool.joints(PursuitState.still(self._points[0] + self._up), self._q_first)[0]

    def unreachable(self, guard: MotionGuard) -> str | None:
        """One sentence on the places, and the points ``above_m`` over them, that ``guard`` or arm forbids;
        None: all are free. Each is looked at from one next to it; the ways between them are not."""
        found = list(self._forbidden(guard))
        if not found:
            return None
        number, why = found[0]
        more = "" if len(found) == 1 else f", and so {len(found) - 1} others"
        return f"{self.words(number)} cannot be used: {why}{more}"

    def _forbidden(self, guard: MotionGuard) -> Iterator[tuple[int, str]]:
        q, last = self._q_first, self._points[0]
        for k in self._beside_each_other():
            try:
                there = self._tool.walked(last, self._points[k], q)
                guard.check_joints(there)
                over = PursuitState.still(self._points[k] + self._up)
                guard.check_joints(self._tool.joints(over, there)[0])
            except CellError as why:
                yield k + 1, why.detail or str(why)
                continue
            q, last = there, self._points[k]

    def _beside_each_other(self) -> Sequence[int]:
        """The places in an order in which each is beside, above or below the one before."""
        grid = self._grid
        rows, columns = (1, 1) if grid is None else (grid.rows, grid.columns)
        layers = np.arange(len(self._points)).reshape(-1, rows, columns)
        layers[1::2] = layers[1::2, ::-1]
        ways = layers.reshape(-1, columns)
        ways[1::2] = ways[1::2, ::-1]
        return [int(k) for k in ways.ravel()]
