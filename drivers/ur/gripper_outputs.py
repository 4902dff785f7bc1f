"""The arm's digital outputs that move a gripper: which levels close and open it, and how RTDE writes them."""

from collections.abc import Sequence

from drivers.ur.rtde import Value

# Names of RTDE's input variables, and the number of the first output of each bank as we count them.
_BANKS = (("standard_digital_output", 0), ("configurable_digital_output", 8), ("tool_digital_output", 16))


class GripperOutputs:
    """``closes`` is the output that is on when closed (off with ``inverted``), ``opens`` the one that is on
    when opened, if there is one."""

    def __init__(self, closes: int, opens: int | None, inverted: bool) -> None:
        self._closes, self._opens, self._inverted = closes, opens, inverted
        self._all = [closes] if opens is None else [closes, opens]

    @property
    def variables(self) -> tuple[str, ...]:
        """What the input recipe has."""
        banks = dict.fromkeys(_bank(output)[0] for output in self._all)
        return tuple(name for bank in banks for name in (f"{bank}_mask", bank))

    def levels(self, close: bool, opening: bool) -> list[tuple[int, bool]]:
        """Each output and its level; ``opening`` is whether the opening output is on."""
        found = [(self._closes, close is not self._inverted)]
        return found if self._opens is None else [*found, (self._opens, opening)]

    def packages(self, levels: Sequence[tuple[int, bool]]) -> list[dict[str, Value]]:
        """What is sent: the levels, then a mask of nothing, as the controller keeps the last one."""
        values: dict[str, Value] = dict.fromkeys(self.variables, 0)
        for output, level in levels:
            bank, first = _bank(output)
            bit = 1 << (output - first)
            values[f"{bank}_mask"] = int(values[f"{bank}_mask"]) | bit  # type: ignore[arg-type]
            values[bank] = int(values[bank]) | (bit if level else 0)  # type: ignore[arg-type]
        let_go = {name: 0 if name.endswith("_mask") else value for name, value in values.items()}
        return [values, let_go]

    def is_closed(self, word: int) -> bool:
        """Whether the arm's outputs ``word`` tell it to be closed."""
        return bool(word >> self._closes & 1) is not self._inverted

    def are(self, word: int, levels: Sequence[tuple[int, bool]]) -> bool:
        """Whether the arm's outputs ``word`` have these levels."""
        return all(bool(word >> output & 1) is level for output, level in levels)


def _bank(output: int) -> tuple[str, int]:
    return [bank for bank in _BANKS if bank[1] <= output][-1]
