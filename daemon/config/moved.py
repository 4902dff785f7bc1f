"""Keys that stand elsewhere than they did: they are read at their old place too, with a warning."""

from typing import Any

from daemon.config.findings import Findings

Path = tuple[str, ...]

MOVED: dict[Path, Path] = {("job", "belt-tracking", "belt"): ("robot", "belt_nominal")}


def put_in_place(raw: dict[str, Any], findings: Findings) -> dict[str, Any]:
    """``raw`` with each moved key where it belongs; a finding where both places say something else."""
    for old, new in MOVED.items():
        found, there = _at(raw, old), _at(raw, new)
        if found is None:
            continue
        where = f"[{'.'.join(new[:-1])}] {new[-1]}"
        if there is not None and there != found:
            findings.add(old, f"differs from {where}, where it belongs; remove it here")
            continue
        findings.warn(old, f"belongs to {where}; move it there")
        for path in [path for path in findings.lines if path[: len(old)] == old]:
            findings.lines.setdefault(new + path[len(old) :], findings.lines[path])
        raw = _with(_without(raw, old), new, found)
    return raw


def _at(table: Any, path: Path) -> Any:
    for key in path:
        table = table.get(key) if isinstance(table, dict) else None
    return table


def _without(table: dict[str, Any], path: Path) -> dict[str, Any]:
    key, *rest = path
    if not rest:
        return {k: v for k, v in table.items() if k != key}
    return {**table, key: _without(table[key], tuple(rest))}


def _with(table: Any, path: Path, value: Any) -> Any:
    if not path:
        return value
    if not isinstance(table, dict):
        return table  # what is wrong with it is found where it is read
    key, *rest = path
    return {**table, key: _with(table.get(key, {}), tuple(rest), value)}
