"""The table of the arguments that jobs take from a PLC."""

from collections.abc import Mapping

from cell.procedure import Procedure
from daemon.config.schema import SchemaWithDefaults
from daemon.docs.config import limits_text, toml_text
from daemon.docs.page import cell
from daemon.job_arguments import arguments_of
from procedures.kind import Argument

HEAD = """
## Arguments of jobs

0 leaves a parameter as `[job.NAME]` has it; another number is for that run alone, and `run.json` keeps it.
`cellward start NAME -p KEY=VALUE` gives the same parameter from the command line.

Registers 8-9 (uint32) of a job that has no third argument are the changer number of the tool on the flange,
as `[tool.NAME] changer` gives it ([several tools](tools.md)); 0 is the tool of a start that names none.

| job | registers | type | parameter | bounds | if not configured | meaning |
|---|---|---|---|---|---|---|
"""


def argument_lines(jobs: Mapping[str, type[Procedure]]) -> list[str]:
    """A section of a page, in Markdown: a row for each argument of each job."""
    rows = [_row(name, job, one) for name, job in sorted(jobs.items()) for one in arguments_of(job)]
    return [*HEAD.strip().splitlines(), *rows, ""]


def _row(name: str, job: type[Procedure], argument: Argument) -> str:
    schema = job.Config.model_json_schema(schema_generator=SchemaWithDefaults)
    entry = schema["properties"][argument.key]
    words = ", ".join(f"{number} {word}" for number, word in enumerate(argument.words, 1))
    default = (
        "a value is required" if argument.key in schema.get("required", ()) else toml_text(entry["default"])
    )
    first = 2 + 2 * argument.place
    columns = (
        f"`{name}`",
        f"{first}-{first + 1}",
        argument.type,
        f"`{argument.key}`",
        words or limits_text(entry),
        default,
        entry.get("description", ""),
    )
    return f"| {' | '.join(map(cell, columns))} |"
