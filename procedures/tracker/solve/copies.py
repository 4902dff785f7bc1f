"""Samples that are there twice: rows of a table that was joined to itself look like readings of their own."""

from collections.abc import Collection, Sequence

from cell.formats.kincal import Kincal


def copies_of(data: Kincal, names: Sequence[str], unusable: Collection[int]) -> dict[int, int]:
    """Samples that agree with an earlier one to the last digit, in joints, reflector and reading, and with
    which. A tracker that measures again never does that."""
    seen: dict[tuple[object, ...], int] = {}
    out = {}
    for k, sample in enumerate(data.samples):
        if k in unusable or sample.p_tracker is None:
            continue
        first = seen.setdefault((names[k], *sample.q, *sample.p_tracker), k)
        if first != k:
            out[k] = first
    return out


def copies_warning(count: int) -> tuple[str, str]:
    """Code and text."""
    return (
        "samples.copies",
        f"{count} samples repeat others to the last digit and were left out: they are no readings of their "
        "own, and would make the result look surer than it is",
    )
