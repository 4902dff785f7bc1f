"""Which program this is: what every record says it was made by."""

from functools import cache


@cache
def software() -> str:
    """Name and version, as in ``cellward 0.1.0``."""
    from importlib.metadata import version  # tens of milliseconds, which not every command needs

    return f"cellward {version('cellward')}"
