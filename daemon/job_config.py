"""The configuration of one run: the job's section with the parameters of a start, refused in plain words."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from cell.errors import error
from cell.procedure import Procedure
from daemon.config import CellConfig
from daemon.config.checks import check_units
from daemon.config.findings import Findings, did_you_mean
from daemon.tools import ARGUMENT


def make_procedure(
    cls: type[Procedure],
    config: CellConfig,
    params: Mapping[str, str],
    recipe: Mapping[str, Any] | None = None,
) -> Procedure:
    """The job with its configuration, the tool apart: ``params`` over a ``recipe`` over the job's section.

    ``ARGUMENT_INVALID`` names each parameter that is wrong
    and why, ``CONFIG_INVALID`` says that the job has no section and needs one."""
    job, fields = cls.name, cls.Config.model_fields
    params = {key: value for key, value in params.items() if key != ARGUMENT}
    if unknown := sorted(set(params) - set(fields)):
        hint = did_you_mean(unknown[0], fields) or f"; it has {', '.join(sorted({*fields, ARGUMENT}))}"
        raise error("ARGUMENT_INVALID", f"{job} has no parameter '{unknown[0]}'{hint}")
    prepared = {key: value for key, value in (recipe or {}).items() if key != ARGUMENT}
    given: dict[str, Any] = {**_inherited(cls, config), **config.job_section(job), **prepared, **params}
    try:
        return cls(cls.Config.model_validate(given))
    except ValidationError as exc:
        if job not in config.job and all(item["type"] == "missing" for item in exc.errors()):
            needs = ", ".join(".".join(str(p) for p in item["loc"]) for item in exc.errors())
            raise error(
                "CONFIG_INVALID", f"[job.{job}] is not configured; cell.toml needs that section, with {needs}"
            ) from exc
        findings = Findings(job)
        check_units({key: _number(value) for key, value in params.items()}, findings)
        findings.add_validation((), given, cls.Config, exc)
        raise error("ARGUMENT_INVALID", "; ".join(findings.plain)) from exc


def _inherited(cls: type[Procedure], config: CellConfig) -> dict[str, Any]:
    """What the job takes from the sections of other jobs."""
    sections = [(config.job_section(other.name), keys) for other, keys in cls.inherits.items()]
    return {key: section[key] for section, keys in sections for key in keys if key in section}


def _number(text: Any) -> Any:
    """A parameter's text as the number that it stands for, if it does."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return text
