"""The shipped example of a cell.toml with every part of it that is commented out."""

import re
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "deploy" / "cell.toml"
_COMMENTED = re.compile(r"# (\[.*|[\w.\-]+ = .*)$")
# In place of the example's total station: a laser tracker, whose program sends lines.
LASER_TRACKER = {
    'driver = "geocom"\n': (
        'driver = "line-stream"\nserial = "1"\nsigma0_m = 0.000015\nsigma_per_m = 0.000006\n'
        'columns = { x = 1, y = 2, z = 3 }\nlength_unit = "m"\n'
    ),
    "checksum = true ": "# checksum = true ",
}


def whole_example(folder: Path, replaced: dict[str, str] | None = None) -> Path:
    """``cell.toml`` in ``folder``, with each text of ``replaced`` in place of its key; not the palletizer."""
    lines = (_COMMENTED.sub(r"\1", line) for line in EXAMPLE.read_text("utf-8").splitlines())
    text = "\n".join(line for line in lines if not line.startswith("observed_")) + "\n"
    text = re.sub(r"\[device\.palletizer\].*?(?=# A conveyor)", "", text, flags=re.DOTALL)
    for old, new in (replaced or {}).items():
        if old not in text:
            raise LookupError(f"the example has no {old!r}")
        text = text.replace(old, new, 1)
    path = folder / "cell.toml"
    path.write_text(text, "utf-8")
    path.chmod(0o600)
    return path
