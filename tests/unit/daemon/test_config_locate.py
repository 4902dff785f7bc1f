"""Where a key stands in a TOML file."""

import tomllib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.config.locate import line_of, locate

TEXT = '''# a comment with [brackets] and = signs
schema = 1
[cell]
name = "bay # 3"  # not a comment inside
text = """
[not.a.table]
key = 1
"""
raw = \'C:\\\'

[device.arm]
host = "x"
"quoted key" = [1,
  2,  # two
  { inner = "]", other = 3 },
]
tool = { name = "g", T_flange_tool = [0,
   0.5], nested = { deep = 1979-05-27T07:32:00Z } }
a.b.c = -1.5e3
[[limits.box]]
min = 1
[[limits.box]]
min = 2
  [limits.box.sub]
  x = true
'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("schema",), 2),
        (("cell",), 3),
        (("cell", "name"), 4),
        (("cell", "text"), 5),
        (("cell", "raw"), 9),
        (("device",), 11),
        (("device", "arm"), 11),
        (("device", "arm", "host"), 12),
        (("device", "arm", "quoted key"), 13),
        (("device", "arm", "quoted key", 1), 14),
        (("device", "arm", "quoted key", 2, "other"), 15),
        (("device", "arm", "tool"), 17),
        (("device", "arm", "tool", "T_flange_tool", 1), 18),
        (("device", "arm", "tool", "nested", "deep"), 18),
        (("device", "arm", "a", "b", "c"), 19),
        (("limits", "box", 0, "min"), 21),
        (("limits", "box", 1, "min"), 23),
        (("limits", "box", 1, "sub", "x"), 25),
    ],
)
def test_every_key_has_its_line(path: tuple[str | int, ...], line: int) -> None:
    assert locate(TEXT)[path] == line


def test_a_missing_key_is_placed_at_the_table_that_lacks_it() -> None:
    lines = locate(TEXT)
    assert line_of(lines, ("device", "arm", "port")) == 11
    assert line_of(lines, ("nowhere",)) == 1


def test_all_keys_that_tomllib_finds_are_found() -> None:
    lines = locate(TEXT)

    def walk(value: Any, path: tuple[str | int, ...]) -> None:
        if path:
            assert path in lines
        items = (
            value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        )
        for key, item in items:
            walk(item, (*path, key))

    walk(tomllib.loads(TEXT), ())


@given(st.dictionaries(st.from_regex(r"[a-z]{1,4}", fullmatch=True), st.text("ab\"'#[]{}=,\n\\", max_size=8)))
def test_strings_full_of_signs_do_not_mislead(values: dict[str, str]) -> None:
    lines = []
    for key, value in values.items():
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        lines.append(f'{key} = "{escaped}"')
    text = "\n".join(lines)
    assert tomllib.loads(text) == values
    assert locate(text) == {(key,): number for number, key in enumerate(values, 1)}
