"""Signatures as the page shows them."""

from typing import Any

from cell.store.signatures import Checked


def told(checked: Checked) -> dict[str, Any]:
    """One of them without the sums of its files; ``name`` is null of a file that cannot be read."""
    by = checked.signature
    keys = ("at", "name", "role", "remark", "user", "digest")
    return {**{key: getattr(by, key, None) for key in keys}, "changed": checked.changed}
