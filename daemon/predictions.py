"""What is expected of each job before anything moves: ``cellward check`` and the page tell it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from cell.errors import CellError
from daemon.config import CellConfig
from daemon.tools import CellTool, tools_of, usual_tool
from daemon.values import configured_values
from procedures.documents import kind_named
from procedures.kind import load
from procedures.registry import JOBS
from procedures.setup import Setup

NOMINAL = ("T_flange_camera_nominal", "T_base_camera_nominal", "T_flange_target_nominal")


def predictions(config: CellConfig) -> list[dict[str, Any]]:
    """One entry a configured job that can be predicted: ``job``, ``text``, the figures, and what was found.

    ``problems`` keep the job from succeeding, ``cautions`` do not; each is a sentence with its fix. Each of
    ``limits`` has a figure (``name``, ``value``, SI) and the ``limit`` that ``job`` will hold it against.
    """
    found = []
    for job, section in _sections(config).items():
        usual = usual_tool(config, job)
        for tool in [usual] if usual is not None else tools_of(config).values():
            if made := _prediction(setup_of(config, tool), job, section):
                found.append(made | ({} if usual is not None else {"tool": tool.name}))
    return found


def prediction_of(config: CellConfig, job: str, tool: str | None = None) -> dict[str, Any] | None:
    """What :func:`predictions` tells of one job with its own limits alone; None where nothing can be told.

    ``tool`` is on the flange, by its name; None: the one of a start that names none.

    A job that is expected of nothing by itself goes by the section of another one, as a check of a tool by
    that of its reference.
    """
    found = usual_tool(config, job) if tool is None else tools_of(config)[tool]
    setup, sections = setup_of(config, found), _sections(config)
    for name in (job, *(other.name for other in JOBS[job].inherits)):
        if name in sections and (made := _prediction(setup, name, sections[name])):
            return made | {"limits": [one for one in made.get("limits", ()) if one["job"] == job]}
    return None


def _prediction(setup: Setup, job: str, section: BaseModel) -> dict[str, Any] | None:
    if not (expectation := kind_named(JOBS[job].kind).expectation):
        return None
    try:
        return {"job": job, **load(expectation)(setup, section)}
    except CellError as exc:  # one job that cannot be predicted hides nothing of the others
        return {"job": job, "text": "no prediction", "problems": [f"{exc}. {exc.hint}"]}


def found_in(predictions: list[dict[str, Any]], kind: str) -> list[str]:
    """The ``problems`` (a job cannot succeed) or ``cautions`` of all predictions, each with its job."""
    return [f"{named(job)}: {text}" for job in predictions for text in job.get(kind, [])]


def named(prediction: Mapping[str, Any]) -> str:
    """Its job, and the tool that it is for where there is one such for each."""
    job, tool = str(prediction["job"]), prediction.get("tool")
    return job if tool is None else f"{job} of tool '{tool}'"


def setup_of(config: CellConfig, tool: CellTool | None = None) -> Setup:
    """The cell as a job's expectation sees it, with ``tool`` on the flange."""
    return Setup(
        config.robot.roles(),
        config.device,
        configured_values(config, tool),
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
