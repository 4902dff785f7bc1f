"""Tables of parsed TOML that may be anything yet: what is no table reads as an empty one."""

from collections.abc import Mapping
from typing import Any


def table(raw: Mapping[str, Any], key: str) -> dict[str, Any]:
    """The table under ``key``."""
    value = raw.get(key)
    return value if isinstance(value, dict) else {}


def tables(value: Any) -> dict[str, dict[str, Any]]:
    """The tables in a table by their names, without what else is in it."""
    return {n: s for n, s in value.items() if isinstance(s, dict)} if isinstance(value, dict) else {}
