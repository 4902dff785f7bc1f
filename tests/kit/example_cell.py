"""The shipped example of a cell.toml with every part of it that is commented out."""

import json
import re
from pathlib import Path

from cell.errors import present
from fakes.world.scenario import Scenario

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

# The delay of the encoder on the example's belt, in place of that of its beams.
ENCODER_DELAY = {'source = "beams"': 'source = "belt"'}

# The example's palletizer in place of its arm in what the tracker samples, and targets for it.
PALLETIZER = LASER_TRACKER | {
    "T_base_tracker_nominal = [-2.4, -1.7, 1.1, 0.0, 0.0, -0.95]\n": (
        "T_base_tracker_nominal = [4.2, -1.4, 1.3, 0.0, 0.0, 2.1]\n"
        'arm = "observed_arm"\npayload_kg = 60.0\nsight = { link_radius_m = 0.1 }\n'
        "joint_ranges_rad = [[-2.4, 2.4], [0.8, 2.1], [-2.2, -0.6], [-3.0, 3.0]]\n"
    ),
    "{ point = [-0.05, 0.0, 0.06], normal = [0.0, 0.0, 1.0], half_angle_rad = 0.45 }": (
        "{ point = [0.12, 0.05, -0.06] }"
    ),
    "point = [0.35, 0.35, 0.02]": "point = [1.9, 1.9, 0.12]",
    "point = [0.35, -0.35, 0.02]": "point = [1.5, -2.6, 0.10]",
    "point = [-0.35, 0.45, 0.02]": "point = [3.4, 1.2, 1.9]",
    "[job.belt-calibration]": (
        '[job.corrected-targets]\nreflector = "smr1"\n'
        "targets = [[1.7, 0.4, 0.6, 0.3], [1.5, -0.7, 0.9, -0.8], [2.0, 0.1, 0.4, 0.0], "
        "[1.6, 0.8, 1.1, 1.0]]\n"
        "[job.belt-calibration]"
    ),
}


def palletizer_example(folder: Path, replaced: dict[str, str] | None = None) -> Path:
    """``cell.toml`` in ``folder`` with the palletizer too, of whose arm the ROBOT is beside it, and a tracker
    that samples it."""
    truth = Scenario.load("palletizer").world.observed
    (folder / "palletizer.json").write_text(json.dumps(present(truth, "palletizer").robot), "utf-8")
    return whole_example(folder, PALLETIZER | (replaced or {}), palletizer=True)


def whole_example(folder: Path, replaced: dict[str, str] | None = None, palletizer: bool = False) -> Path:
    """``cell.toml`` in ``folder``, with each text of ``replaced`` in place of its key, and the palletizer if
    wanted."""
    lines = (_COMMENTED.sub(r"\1", line) for line in EXAMPLE.read_text("utf-8").splitlines())
    kept = [line for line in lines if palletizer or not line.startswith("observed_")]
    text = "\n".join(kept) + "\n"
    if not palletizer:
        text = re.sub(r"\[device\.palletizer\].*?(?=# A conveyor)", "", text, flags=re.DOTALL)
    for old, new in (replaced or {}).items():
        if old not in text:
            raise LookupError(f"the example has no {old!r}")
        text = text.replace(old, new, 1)
    path = folder / "cell.toml"
    path.write_text(text, "utf-8")
    path.chmod(0o600)
    return path
