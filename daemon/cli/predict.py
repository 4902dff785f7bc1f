"""What ``cellward check`` expects of each job before anything moves."""

from pathlib import Path
from typing import Any

from pydantic import BaseModel

from cell.errors import CellError
from daemon.config import CellConfig
from daemon.values import configured_values
from procedures.documents import kind_named
from procedures.kind import load
from procedures.registry import JOBS
from procedures.setup import Setup

NOMINAL = ("T_flange_camera_nominal", "T_base_camera_nominal", "T_flange_target_nominal")


def predictions(config: CellConfig) -> list[dict[str, Any]]:
    """One entry a configured job that can be predicted: ``job``, ``text``, the figures, and what was found.

    ``problems`` keep the job from succeeding, ``cautions`` do not; each is a sentence with its fix.
    """
    setup, found = setup_of(config), []
    for name, section in _sections(config).items():
        if not (expectation := kind_named(JOBS[name].kind).expectation):
            continue
        try:
            expected = load(expectation)(setup, section)
        except CellError as exc:  # one job that cannot be predicted hides nothing of the others
            expected = {"text": "no prediction", "problems": [f"{exc}. {exc.hint}"]}
        found.append({"job": name, **expected})
    return found


def found_in(predictions: list[dict[str, Any]], kind: str) -> list[str]:
    """The ``problems`` (a job cannot succeed) or ``cautions`` of all predictions, each with its job."""
    return [f"{job['job']}: {text}" for job in predictions for text in job.get(kind, [])]


def setup_of(config: CellConfig) -> Setup:
    """The cell as a job's expectation sees it."""
    return Setup(
        config.robot.roles(),
        config.device,
        configured_values(config),
        {key: getattr(config.robot, key) for key in NOMINAL},
        list(_sections(config).values()),
        lambda: ledger_rows(config),
    )


def _sections(config: CellConfig) -> dict[str, BaseModel]:
    """The configured jobs with their sections, in the order of the jobs."""
    return {
        name: job.Config.model_validate(section)
        for name, job in JOBS.items()
        if (section := config.job_section(name))
    }


def ledger_rows(config: CellConfig) -> list[dict[str, Any]]:
    """What the cell's ledger has of calibrations, newest first; nothing while there is no ledger."""
    from cell.store.ledger import Ledger

    path = Path(config.cell.state_dir) / "ledger.sqlite"
    if not path.exists():
        return []
    ledger = Ledger(path, read_only=True)
    try:
        return ledger.results(limit=1000)
    finally:
        ledger.close()
