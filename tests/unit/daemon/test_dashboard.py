"""The dashboard for Grafana asks for nothing that the daemon does not export."""

import json
import re
from pathlib import Path
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest

from cell.packml import PackML
from daemon.web.metrics import CellCollector

FILE = Path(__file__).parents[3] / "deploy/grafana/cellward.json"


class Engine:
    """A status with every part that is exported."""

    def status(self) -> dict[str, Any]:
        return {
            "cell": "bay-3", "twin": False, "packml_number": 4, "job_number": 0, "run_id": None, "step": 0,
            "steps": 0, "error": None, "latched": False, "prompt": None, "waiting": [],
            "disk": {"free_bytes": 10**10}, "loop_lag": {"max_s": 0.001}, "live": {"speed": 0.1},
            "devices": {"arm": {"state": "READY", "losses": 2}},
        }  # fmt: skip


def test_every_expression_is_of_exported_metrics() -> None:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(CellCollector(Engine()))  # type: ignore[arg-type]
    exported = set(re.findall(r"(?m)^(cellward_\w+)", generate_latest(registry).decode()))
    panels = json.loads(FILE.read_text("utf-8"))["panels"]
    asked = {name for p in panels for t in p["targets"] for name in re.findall(r"cellward_\w+", t["expr"])}
    assert asked <= exported
    assert len({panel["id"] for panel in panels}) == len(panels) > 10


def test_states_have_the_names_of_packml() -> None:
    (state,) = (p for p in json.loads(FILE.read_text("utf-8"))["panels"] if p["title"] == "State")
    options = state["fieldConfig"]["defaults"]["mappings"][0]["options"]
    assert {int(n): entry["text"].upper() for n, entry in options.items()} == {int(s): s.name for s in PackML}
