"""Light beams on an input module: the filter that is set in it is said, and is short."""

from pathlib import Path

import pytest

from daemon.config import load_config

CELL = """schema = 1
[cell]
name = "bay"
[device.beams]
driver = "modbus-inputs"
url = "tcp://192.168.10.30:502"
inputs = { xs = { address = 0 }, ys = { address = 1 } }
"""


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("", "set the filter of these inputs in the module"),
        ("filter_s = 0.1", "a beam has to be broken for 1 mm to be seen"),
        ("filter_s = 0.001", ""),
        ("filter_s = 0.0", ""),
    ],
)
def test_a_filter_that_is_not_known_or_is_long_is_warned_of(keys: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(f"{CELL}{keys}\n")
    path.chmod(0o600)
    found = [w for w in load_config(path).warnings if "device.beams.filter_s" in w]
    assert len(found) == bool(told)
    assert all(told in warning for warning in found)
