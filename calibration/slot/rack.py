"""A rack of slots in rows and columns, one pitch apart, that all lead the same way."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True)
class Rack:
    """Slots are counted from 1 along the columns of the first row, then of the next.

    The rack's frame has the middle of the first slot's opening as origin, x along the columns, y along the
    rows, and z into the slots. ``column_pitch`` and ``row_pitch`` in m.
    """

    rows: int
    columns: int
    row_pitch: float
    column_pitch: float

    @property
    def slots(self) -> int:
        return self.rows * self.columns

    def T_rack_slot(self, number: int) -> RigidTransform:
        """Where slot ``number`` (from 1) is; its frame is turned as the rack's."""
        row, column = divmod(number - 1, self.columns)
        return RigidTransform.from_translation([column * self.column_pitch, row * self.row_pitch, 0.0])

    def row_and_column(self, number: int) -> tuple[int, int]:
        """Both counted from 1."""
        row, column = divmod(number - 1, self.columns)
        return row + 1, column + 1
