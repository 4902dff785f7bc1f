"""What is expected of each job before anything moves: ``cellward check`` and the page tell it."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from cell.errors import CellError, error
from daemon.config import CellConfig
from daemon.config.locate import Path as Place
from daemon.config.recipes import Recipe
from daemon.job_config import make_procedure
from daemon.tools import ARGUMENT, CellTool, tools_of, usual_tool
from daemon.values import configured_values, stated
from procedures.documents import kind_named
from procedures.kind import load
from procedures.registry import JOBS
from procedures.setup import Setup

if TYPE_CHECKING:
    from cell.store.ledger import Ledger

_KEY = re.compile(r"(\w+(?:\[\d+\]|\.\w+)*): ")
NOMINAL = ("T_flange_camera_nominal", "T_base_camera_nominal", "T_flange_target_nominal")


def predictions(config: CellConfig) -> list[dict[str, Any]]:
    """One entry a configured job that can be predicted: ``job``, ``text``, the figures, and what was found.

    ``problems`` keep the job from succeeding, ``cautions`` do not; each is a sentence with its fix. Each of
    ``limits`` has a figure (``name``, ``value``, SI) and the ``limit`` that ``job`` will hold it against.
    A ``recipe`` has an entry where something else is told of it than of its job.
    """
    found = []
    for job, section in _sections(config).items():
        usual = usual_tool(config, job)
        for tool in [usual] if usual is not None else tools_of(config).values():
            if made := _prediction(setup_of(config, tool), job, section):
                found.append(made | ({} if usual is not None else {"tool": tool.name}))
    for name, recipe in config.recipe.items():
        if _tool_of(config, recipe.job, recipe, None) is None:
            continue
        if (made := prediction_of(config, name)) and not any(_told_by(made, other) for other in found):
            found.append(made | {"job": recipe.job, "recipe": name})
    return found


def _told_by(prediction: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether the ``other`` one, which may have limits of more jobs, says all of it."""
    same = all(prediction.get(key) == other.get(key) for key in ("job", "text", "problems", "cautions"))
    return same and all(limit in other.get("limits", ()) for limit in prediction.get("limits", ()))


def _tool_of(config: CellConfig, job: str, recipe: Recipe | None, tool: str | None) -> CellTool | None:
    """The tool of a start of the job, or by the recipe, that names ``tool``."""
    name = tool or (recipe.parameters.get(ARGUMENT) if recipe is not None else None)
    return usual_tool(config, job) if name is None else tools_of(config)[name]


def prediction_of(config: CellConfig, name: str, tool: str | None = None) -> dict[str, Any] | None:
    """What :func:`predictions` tells of one job or recipe, with the limits of this job alone; None where
    nothing can be told.

    ``tool`` is on the flange, by its name; None: the one of a start that names none.

    A job that is expected of nothing by itself goes by the section of another one, as a check of a tool by
    that of its reference.
    """
    recipe = config.recipe.get(name)
    job, sections = name if recipe is None else recipe.job, _sections(config, recipe)
    if job not in JOBS:
        return None
    setup = setup_of(config, _tool_of(config, job, recipe, tool), sections)
    for by in (job, *(other.name for other in JOBS[job].inherits)):
        if by in sections and (made := _prediction(setup, by, sections[by])):
            return made | {"limits": [one for one in made.get("limits", ()) if one["job"] == job]}
    return None


def _prediction(setup: Setup, job: str, section: BaseModel) -> dict[str, Any] | None:
    if not (expectation := kind_named(JOBS[job].kind).expectation):
        return None
    try:
        return {"job": job, **load(expectation)(setup, section)}
    except CellError as exc:  # one job that cannot be predicted hides nothing of the others
        return {"job": job, "text": "no prediction", "problems": [f"{exc}. {exc.hint}"]}


def found_in(
    predictions: list[dict[str, Any]], kind: str, line_at: Callable[[Place], str] = lambda _: ""
) -> list[str]:
    """The ``problems`` (a job cannot succeed) or ``cautions`` of all predictions, each with its job.

    One that begins with a key of the job's section has in front what ``line_at`` says of that key, which is
    nothing where the file does not have it.
    """
    return [
        next(filter(None, map(line_at, _places(job, text))), "") + f"{named(job)}: {text}"
        for job in predictions
        for text in job.get(kind, [])
    ]


def _places(prediction: Mapping[str, Any], text: str) -> list[Place]:
    """Where the key may stand that ``text`` begins with: in a recipe, else in the section of its job."""
    if (key := _KEY.match(text)) is None:
        return []
    path = [int(part) if part.isdecimal() else part for part in re.findall(r"\w+", key[1])]
    tables = [("job", prediction["job"])]
    if "recipe" in prediction:
        tables.insert(0, ("recipe", prediction["recipe"]))
    return [(*table, *path) for table in tables]


def named(prediction: Mapping[str, Any]) -> str:
    """Its job, and the recipe or the tool that it is for where that makes a difference."""
    job = str(prediction["job"])
    if "recipe" in prediction:
        return f"recipe {prediction['recipe']}, {job}"
    tool = prediction.get("tool")
    return job if tool is None else f"{job} of tool '{tool}'"


def setup_of(
    config: CellConfig, tool: CellTool | None = None, sections: Mapping[str, BaseModel] | None = None
) -> Setup:
    """The cell as a job's expectation sees it, with ``tool`` on the flange and the jobs' ``sections``, those
    of ``config`` where none are given."""
    return Setup(
        config.robot.roles(),
        config.device,
        configured_values(config, tool),
        {key: getattr(config.robot, key) for key in NOMINAL},
        list((_sections(config) if sections is None else sections).values()),
        lambda: ledger_rows(config),
        lambda name: _stated_now(config, name),
    )


def _sections(config: CellConfig, recipe: Recipe | None = None) -> dict[str, BaseModel]:
    """The configured jobs with their sections, in the order of the jobs; that of a ``recipe`` with its
    arguments, also where the job has no section of its own."""
    found = {
        name: job.Config.model_validate(section)
        for name, job in JOBS.items()
        if (section := config.job_section(name))
    }
    if recipe is not None and recipe.job in JOBS:
        found[recipe.job] = make_procedure(JOBS[recipe.job], config, {}, recipe.parameters).config
    return found


def _stated_now(config: CellConfig, name: str) -> dict[str, Any]:
    """What the version of ``name`` in effect states of its uncertainty; nothing while there is none."""
    ledger = _ledger_of(config)
    if ledger is None:
        return {}
    try:
        return stated((ledger.in_effect(name) or {}).get("result"))
    finally:
        ledger.close()


def ledger_rows(config: CellConfig) -> list[dict[str, Any]]:
    """What the cell's ledger has of calibrations, newest first; nothing while there is no ledger."""
    ledger = _ledger_of(config)
    if ledger is None:
        return []
    try:
        return ledger.results(limit=1000)
    finally:
        ledger.close()


def _ledger_of(config: CellConfig) -> "Ledger | None":
    """To be closed by whoever asks; None while there is none."""
    from cell.store.ledger import Ledger

    path = Path(config.cell.state_dir) / "ledger.sqlite"
    try:
        return Ledger(path, read_only=True) if path.exists() else None
    except PermissionError as exc:
        raise error("ACCESS_DENIED", f"{path}: {exc.strerror}") from exc
