"""How many objects the collector looks at while a job runs."""

import subprocess
import sys

# A buffer of samples that is full: each new one frees the oldest.
_SCRIPT = """
import gc
from collections import deque
from daemon.collector import freeze_start_up

freeze_start_up()
looked_at = []
def note(phase, info):
    if phase == "start":
        looked_at.append(sum(len(gc.get_objects(g)) for g in range(info["generation"] + 1)))
gc.callbacks.append(note)
samples = deque(maxlen=5_000)
for k in range(20_000):
    samples.append([[k], [k], [k], [k], [k]])
gc.callbacks.remove(note)
print(len(looked_at), max(looked_at))
"""


def test_a_collection_looks_at_a_few_thousand_objects_beside_a_stream_of_samples() -> None:
    done = subprocess.run([sys.executable, "-c", _SCRIPT], capture_output=True, text=True, check=True)
    collections, most = map(int, done.stdout.split())
    assert collections > 0
    assert most < 5_000
