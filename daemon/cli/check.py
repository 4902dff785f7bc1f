"""``cellward check``: is the configuration right, what can be expected of it, and do the devices answer?"""

from typing import Annotated, Any

import typer

from daemon.cli.failures import BAD_INPUT
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
    """Check the configuration (every finding at once), and predict what the jobs can reach.

    Exit code 2 when a job cannot succeed with it; a warning alone changes nothing.
    """
    from daemon.cli.predict import predictions
    from daemon.cli.predict_arm import arm_in_use, strangers
    from daemon.cli.predict_values import found_in
    from daemon.config import load_config

    path = config_path(config)
    loaded = load_config(path)
    expected = predictions(loaded)
    problems = found_in(expected, "problems")
    arm = arm_in_use(loaded)
    doubts = [f"arm: {text}" for text in arm["cautions"]] if arm else []
    warnings = [*loaded.warnings, *doubts, *found_in(expected, "cautions")]
    for problem in problems:
        say(f"Error: {problem}")
    for warning in warnings:
        say(f"Warning: {warning}")
    found = _probe(loaded) if probe else []
    serials = {d["device"]: d["serial"] for d in found if d["serial"]}
    for stranger in strangers(loaded, serials) if serials else ():
        warnings.append(stranger)
        say(f"Warning: {stranger}")
    if as_json:
        shown = {"config": str(path), "problems": problems, "warnings": warnings, "arm": arm}
        out_json({**shown, "predictions": expected, "devices": found})
    else:
        about = f"cell '{loaded.cell.name}', {len(loaded.device)} devices"
        failing = "could be read, but jobs cannot succeed with it" if problems else "is valid"
        out(f"{path} {failing}: {about}")
        if arm is not None:
            out(f"arm: {arm['text']}")
        for job in expected:
            out(f"{job['job']} {job['text']}")
        if probe:
            columns = ("device", "answer", "model", "serial")
            out(table(columns, ([d["device"], d["answer"], d["model"], d["serial"]] for d in found)))
    bad = [d for d in found if d["exit_code"]]
    if bad:
        say(bad[0]["hint"])
    if problems or bad:
        raise typer.Exit(BAD_INPUT if problems else bad[0]["exit_code"])


def _probe(config: Any) -> list[dict[str, Any]]:
    import asyncio

    from daemon.cli.probe import probe_devices

    return asyncio.run(probe_devices(config))
