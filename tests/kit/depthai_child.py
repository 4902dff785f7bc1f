"""depthai in a process of its own: it changes signal handlers and starts threads when it is imported."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

QUIET = {"DEPTHAI_TELEMETRY": "0", "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0"}
ASKED = """
import json, sys
cases = json.load(sys.stdin)
print("ANSWERS" + json.dumps({name: answer(**case) for name, case in cases.items()}))
"""


def answers(script: str, cases: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What ``answer(**case)`` of ``script`` returns for each case by name; the library loads once for all."""
    done = subprocess.run(
        [sys.executable, "-c", script + ASKED],
        input=json.dumps(cases),
        capture_output=True,
        text=True,
        timeout=300,  # of a hang: on a busy PC the library alone can take a minute to load
        env={**os.environ, **QUIET},
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.partition("ANSWERS")[2]))
