"""What the keys of a gripper on switched outputs must agree on, whoever switches them."""

from typing import Protocol


class ValveKeys(Protocol):
    """The keys that every such gripper has."""

    output: int
    open_output: int | None
    blow_off_s: float | None
    confirm: int | None
    moves_s: float | None


def check_valve(keys: ValveKeys) -> None:
    """``ValueError`` that names what contradicts itself."""
    if keys.confirm is None and keys.moves_s is None:
        raise ValueError(
            "give confirm, or moves_s: without an input that confirms, it is unknown when it has closed"
        )
    if keys.open_output == keys.output:
        raise ValueError(f"open_output is {keys.output}, which is output; give another one, or none")
    if keys.blow_off_s is not None and keys.open_output is None:
        raise ValueError("blow_off_s is of an open_output: give that too")
