"""Commands around the configuration and the daemon itself: run, token, explain, config."""

from dataclasses import asdict
from difflib import get_close_matches
from typing import Annotated

import typer

from cell.collector import without_collector
from cell.errors import catalogue, error, find_entry
from daemon.cli.options import ConfigOption, JsonOption, config_path
from daemon.cli.output import out, out_json, say

config_app = typer.Typer(help="About cell.toml.", no_args_is_help=True)


def run(config: ConfigOption = None) -> None:
    """The daemon, in the foreground; systemd starts it so."""
    path = config_path(config)
    with without_collector():
        from daemon.app import main

    raise typer.Exit(main(path))


def token(
    name: Annotated[str, typer.Argument(help="Whose it is: a person, or a panel.", show_default=False)],
    role: Annotated[
        str, typer.Option("--role", help="viewer (looks, may stop), operator, or integrator.")
    ] = "operator",
) -> None:
    """Make a token to log in to the page: it is shown once; the section for cell.toml is printed.

    'cellward token anna >> cell.toml' adds anna; the daemon knows her from its next start on.
    """
    from pydantic import ValidationError

    from daemon.config.faces import HttpSection
    from daemon.web.tokens import digest, new_token

    made = new_token()
    try:
        HttpSection.model_validate({"user": {name: {"role": role, "token_sha256": digest(made)}}})
    except ValidationError:
        raise error(
            "ARGUMENT_INVALID",
            f"'{name}' with role '{role}': a name has up to 32 letters, digits, '.', '_' or '-', and a role "
            "is viewer, operator or integrator",
        ) from None
    out(f'[http.user."{name}"]\nrole = "{role}"\ntoken_sha256 = "{digest(made)}"')
    say(f"The token of {name} is {made}. It is shown this once: keep it, for only its digest is in the file.")


def explain(
    code: Annotated[str, typer.Argument(help="A number or a name, for instance 3001.", show_default=False)],
    as_json: JsonOption = False,
) -> None:
    """What an error code means, and what to do."""
    entry = find_entry(code)
    if entry is None:
        names = [e.name for e in catalogue().values()] + [str(e.code) for e in catalogue().values()]
        near = get_close_matches(code.upper(), names, n=1)
        meant = f", did you mean {near[0]}?" if near else ""
        raise error("ARGUMENT_INVALID", f"there is no error '{code}'{meant}")
    if as_json:
        out_json({**asdict(entry), "reaction": entry.reaction.value})
    else:
        out(f"{entry.code} {entry.name}: {entry.text}.\n{entry.hint}\n{_REACTIONS[entry.reaction.value]}")


_REACTIONS = {
    "retry": "The daemon tries again by itself; a job that used the device ends.",
    "abort": "The job ends with the arm at rest.",
    "latch": "The job ends and nothing moves before 'cellward reset'.",
    "input": "Nothing happened; the input has to be corrected.",
    "refuse": "Nothing happened; the request can be repeated when the condition is gone.",
    "internal": "This should not happen; please report it.",
}


@config_app.command()
def schema() -> None:
    """Every key of cell.toml with its type, bounds and meaning, as a JSON schema."""
    from daemon.config import json_schema
    from procedures.registry import JOBS

    out_json(json_schema(JOBS))
