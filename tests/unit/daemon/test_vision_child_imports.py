"""What the process of a camera loads before it can take pictures."""

import subprocess
import sys


def test_it_starts_without_scipy() -> None:
    """It would take as long to import as all else."""
    script = "import daemon.vision_child, sys; print(sorted(m for m in sys.modules if m.startswith('scipy')))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "[]", "")
