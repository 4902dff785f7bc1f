"""The manual's tables, generated from the code; a test says when they are stale."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daemon.config import init_text, json_schema
from daemon.docs.architecture import architecture_page
from daemon.docs.can import can_page
from daemon.docs.config import config_page
from daemon.docs.errors import errors_page
from daemon.docs.jobs import jobs_page
from daemon.docs.registers import registers_page
from daemon.docs.results import results_page
from daemon.modbus import register_table

ROOT = Path(__file__).parents[2]


def generated(jobs: Mapping[str, Any]) -> dict[str, str]:
    """Every generated file by its path in the repository."""
    schema = json.dumps(json_schema(jobs), indent=1, ensure_ascii=False, sort_keys=True)
    return {
        "docs/registers.md": registers_page(register_table(), jobs),
        "docs/can.md": can_page(register_table()),
        "docs/errors.md": errors_page(),
        "docs/results.md": results_page(),
        "docs/config.md": config_page(jobs),
        "docs/jobs.md": jobs_page(jobs),
        "docs/architecture.md": architecture_page(ROOT),
        "docs/cell.schema.json": schema + "\n",
        "deploy/cell.toml": init_text(),
    }


def stale(pages: Mapping[str, str], root: Path = ROOT) -> list[str]:
    """The files below ``root`` that are not what :func:`generated` says."""
    return [name for name, text in pages.items() if _text(root / name) != text]


def _text(path: Path) -> str | None:
    return path.read_text("utf-8") if path.exists() else None
