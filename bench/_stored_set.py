"""``python -m bench._stored_set``: measure the demo's stored set anew, in the demo's own twin.

A whole tracker sampling of 40 poses, nothing set aside, on the object face: joints, noise and monuments are
what its arm and its tracker gave. Needed whenever daemon/demo/tracker.toml gets another truth.
"""

import re
import sys
import tempfile
from pathlib import Path

from cell.store.files import read_json, to_json
from daemon.config import load_config
from daemon.demo.fast import run_objects, write_config
from daemon.demo.scenes import OWN, STORED_SET, DemoScene
from daemon.demo.steps import TRACKER_SAMPLING
from procedures.tracker.record import DATA_FILE

POSES = 40
DEMO = Path(__file__).parents[1] / "daemon" / "demo"
KEPT = ("q", "p_tracker", "target", "index")


def main() -> int:
    """Write ``daemon/demo/stored.json``."""
    scene = DemoScene(TRACKER_SAMPLING.twin, (TRACKER_SAMPLING,))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / OWN).write_text((DEMO / f"{scene.twin}.toml").read_text("utf-8"), "utf-8")
        path = write_config(scene, folder)
        text = re.sub(r"(?m)^with_set = .*\n", "held_out_share = 0.0\n", path.read_text("utf-8"))
        path.write_text(re.sub(r"(?m)^poses = \d+$", f"poses = {POSES}", text), "utf-8")
        config = load_config(path)
        run_objects(config, scene.steps)
        (run,) = (Path(config.cell.state_dir) / "runs").iterdir()
        data = read_json(run / DATA_FILE)
    points = data["notes"]["sampling"]["monument_points"]
    data["notes"] = {"how": "python -m bench._stored_set", "sampling": {"monument_points": points}}
    data["samples"] = [{key: sample[key] for key in KEPT} for sample in data["samples"]]
    (DEMO / STORED_SET).write_text(to_json(data, indent=1) + "\n", "utf-8")
    print(f"{len(data['samples'])} poses, written to {DEMO / STORED_SET}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
