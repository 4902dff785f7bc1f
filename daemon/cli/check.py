"""``cellward check``: is the configuration right, what can be expected of it, and do the devices answer?"""

from typing import Annotated, Any

import typer

from daemon.cli.options import ConfigOption, JsonOption, config_path
from daemon.cli.output import out, out_json, say, table


def check(
    probe: Annotated[
        bool,
        typer.Option("--probe", help="Also open each device: no motion, no touch of the arm's program."),
    ] = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check the configuration (every finding at once), and predict what the jobs can reach."""
    from daemon.cli.predict import predictions
    from daemon.config import load_config

    path = config_path(config)
    loaded = load_config(path)
    for warning in loaded.warnings:
        say(f"Warning: {warning}")
    expected = predictions(loaded)
    found = _probe(loaded) if probe else []
    if as_json:
        out_json(
            {"config": str(path), "warnings": loaded.warnings, "predictions": expected, "devices": found}
        )
    else:
        out(f"{path} is valid: cell '{loaded.cell.name}', {len(loaded.device)} devices")
        for job in expected:
            out(f"{job['job']} {job['text']}")
        if probe:
            columns = ("device", "answer", "model", "serial")
            out(table(columns, ([d["device"], d["answer"], d["model"], d["serial"]] for d in found)))
    if bad := [d for d in found if d["exit_code"]]:
        say(bad[0]["hint"])
        raise typer.Exit(bad[0]["exit_code"])


def _probe(config: Any) -> list[dict[str, Any]]:
    import asyncio

    from daemon.cli.probe import probe_devices

    return asyncio.run(probe_devices(config))
