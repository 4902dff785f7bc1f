"""The control program's view of the general purpose registers, with the client's offset."""

import numpy as np
from numpy.typing import ArrayLike


class RegisterBank(dict[str, float]):
    """The general purpose registers by RTDE name; those never written are absent.

    ``revision`` grows with every change, so who packs them for the wire need not look at each.
    """

    revision = 0

    def __setitem__(self, name: str, value: float) -> None:
        if self.get(name) != value:
            self.revision += 1
        super().__setitem__(name, value)

    def clear(self) -> None:
        """Forget all of them."""
        self.revision += 1
        super().clear()


class Registers:
    """Numbers by RTDE name; absent ones are zero."""

    def __init__(self, values: dict[str, float], offset: int = 0) -> None:
        self._values, self._offset = values, offset

    def int_in(self, index: int) -> int:
        return int(self._values.get(f"input_int_register_{index + self._offset}", 0))

    def double_in(self, index: int) -> float:
        return float(self._values.get(f"input_double_register_{index + self._offset}", 0.0))

    def vector_in(self, index: int) -> list[float]:
        """Six numbers from ``index`` on."""
        return [self.double_in(index + k) for k in range(6)]

    def int_out(self, index: int, value: int) -> None:
        self._values[f"output_int_register_{index + self._offset}"] = value

    def vector_out(self, values: ArrayLike, index: int = 0) -> None:
        for k, value in enumerate(np.asarray(values, dtype=float)):
            self._values[f"output_double_register_{index + k + self._offset}"] = float(value)
