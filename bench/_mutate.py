"""Ways to damage a file: its bytes, or one value of its JSON, TOML or JSON lines."""

import copy
import json
import os
import random
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

# fmt: off
NUMBERS: tuple[Any, ...] = (
    1e308, -1e308, 1e30, 1e17, 1e9, -0.0, 0, 5e-324, 1e-300, -1, 10**30, 2**63, 2**31, 0.1, 3, True, None,
    "NaN", "1e308", float("nan"), float("inf"),
)
OTHERS: tuple[Any, ...] = (
    "", "x", "\x00", "\ud800", "../../etc/passwd", "/etc/passwd", ".", "a" * 5000, [], {}, None, 7, [[]],
    [None], {"a": 1},
)
TOML_VALUES = (
    "1e308", "-1", "0", "nan", "inf", "5e-324", "9223372036854775808", '""', '"x"', "[]", "{}", "true",
    '"\\u0000"', '"../x"', "[1, 2]", "1979-05-27", '"' + "a" * 5000 + '"',
)
WAYS = (
    "number", "number", "number", "other", "drop", "rename", "many", "swap", "reverse", "scale", "twice",
)
# fmt: on


def mutate_file(path: Path, rng: random.Random) -> str:
    """Damage the bytes of ``path``, or put something else in its place; says what was done."""
    data = path.read_bytes()
    ways: dict[str, Callable[[], bytes | None]] = {
        "cut": lambda: data[: rng.randrange(len(data) + 1)],
        "cut near the end": lambda: data[: -rng.randrange(1, 40)],
        "flipped bits": lambda: flipped(data, rng),
        "byte order mark": lambda: b"\xef\xbb\xbf" + data,
        "UTF-16": lambda: data.decode("utf-8", "replace").encode("utf-16"),
        "latin-1 byte": lambda: inserted(data, b"\xe4", rng),
        "NUL byte": lambda: inserted(data, b"\0", rng),
        "deeply nested": lambda: b'{"a":' * 3000 + b"[" * 3000,
        "nested inside": lambda: inserted(data, b"[" * 5000, rng),
        "empty": lambda: b"",
        "text": lambda: b"nothing of the kind\n" * 3,
        "doubled": lambda: data + data,
        "a piece lost": lambda: without_piece(data, rng),
        "missing": lambda: _instead(path, lambda: None),
        "a folder": lambda: _instead(path, path.mkdir),
        "a pipe": lambda: _instead(path, lambda: os.mkfifo(path)),
        "a broken link": lambda: _instead(path, lambda: path.symlink_to(path.parent / "no such file")),
        "a link to itself": lambda: _instead(path, lambda: path.symlink_to(path.name)),
    }
    name = rng.choice(list(ways))
    changed = ways[name]()
    if changed is not None:
        path.write_bytes(changed)
    return name


def flipped(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def inserted(data: bytes, piece: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + piece + data[at:]


def without_piece(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[at + rng.randrange(1, 400) :]


def _instead(path: Path, make: Callable[[], object]) -> None:
    path.unlink()
    make()


def mutate_tree(path: Path, rng: random.Random) -> str:
    """Change one place of the tables in ``path``; files without any get damaged bytes instead."""
    text = path.read_text("utf-8", "replace")
    if path.suffix == ".json":
        root = json.loads(text)
        what = change_value(root, rng)
        path.write_text(json.dumps(root), "utf-8")
    elif path.suffix == ".jsonl":
        lines = text.splitlines()
        k = rng.randrange(len(lines))
        entry = json.loads(lines[k])
        what = f"line {k}: {change_value(entry, rng)}"
        lines[k] = json.dumps(entry)
        path.write_text("\n".join(lines) + "\n", "utf-8")
    elif path.suffix == ".toml":
        what = _toml(path, text, rng)
    else:
        return mutate_file(path, rng)
    return what


def _toml(path: Path, text: str, rng: random.Random) -> str:
    lines = text.splitlines()
    keyed = [k for k, line in enumerate(lines) if "=" in line and not line.lstrip().startswith("#")]
    k = rng.choice(keyed)
    key, _, value = lines[k].partition("=")
    way = rng.randrange(5)
    if way == 0:
        del lines[k]
    elif way == 1:
        lines.insert(k, lines[k])
    elif way == 2:
        lines[k] = f"{key.strip()}x = {value}"
    else:
        lines[k] = f"{key}= {rng.choice(TOML_VALUES)}"
    changed = "\n".join(lines) + "\n"
    path.write_text(changed, "utf-8")
    with_error = ""
    try:
        tomllib.loads(changed)
    except tomllib.TOMLDecodeError:
        with_error = " (no TOML)"
    return f"line {k}: {lines[min(k, len(lines) - 1)][:60]}{with_error}"


def _places(node: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [at] if at else []
    children = list(node.items()) if isinstance(node, dict) else []
    if isinstance(node, list):
        children = list(enumerate(node))[:3] + list(enumerate(node))[-1:]
    for key, child in children:
        found += _places(child, (*at, key))
    return found


def change_value(root: Any, rng: random.Random) -> str:
    """One change of one place, often a deep one."""
    at = rng.choice(_places(root))
    parent = root
    for key in at[:-1]:
        parent = parent[key]
    key, old = at[-1], parent[at[-1]]
    way = rng.choice(WAYS)
    where = ".".join(map(str, at))[-70:]
    if way == "number":
        parent[key] = rng.choice(NUMBERS)
    elif way == "other":
        parent[key] = copy.deepcopy(rng.choice(OTHERS))
    elif way == "drop":
        del parent[key]
        return f"{where} dropped"
    elif way == "rename" and isinstance(parent, dict):
        parent[f"{key}x"] = parent.pop(key)
        return f"{where} renamed"
    elif way == "many":
        parent[key] = old * 3000 if isinstance(old, list) and len(json.dumps(old)) < 500 else [old] * 1000
    elif way == "swap" and isinstance(parent, list) and len(parent) > 1:
        other = rng.randrange(len(parent))
        parent[key], parent[other] = parent[other], parent[key]
    elif way == "reverse" and isinstance(old, list):
        parent[key] = old[::-1]
    elif way == "scale" and isinstance(old, int | float) and not isinstance(old, bool):
        parent[key] = old * rng.choice((1e3, -1, 1e-3, 57.29577951308232, 1e6))
    else:
        parent[key] = [old, old]
    return f"{where} = {json.dumps(parent[key])[:60]} ({way})"
