"""The table of commands. Command modules import heavy things inside their functions: start-up is short."""

from typing import Annotated

import typer

from cell.version import software
from daemon.cli import (
    audit,
    calibrations,
    check,
    cross_check,
    demo,
    export,
    history,
    importing,
    init,
    jobs,
    live,
    manual,
    offline,
    place,
    plc_files,
    poses,
    prune,
    record,
    recover,
    rehearse,
    reports,
    service,
    setup,
)

app = typer.Typer(
    name="cellward",
    help="Supervises a robot cell: calibration jobs with their uncertainty. "
    "It supervises; it is not a safety function.",
    epilog="Exit codes: 0 ok, 1 verdict fail or job not completed, 2 bad input, "
    "3 device or daemon unreachable, 4 refused, 5 internal error.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)

PANELS = {
    "Start here": (demo.demo, init.init, check.check, rehearse.rehearse, setup.run, setup.token),
    "Jobs": (
        jobs.status,
        jobs.watch,
        live.live,
        jobs.start,
        jobs.confirm,
        jobs.skip,
        jobs.finish,
        jobs.abort,
        jobs.halt,
        jobs.pause,
        jobs.resume,
        jobs.reset,
    ),
    "Runs": (
        history.runs,
        history.show,
        history.report,
        reports.reports,
        history.compare,
        cross_check.cross_check,
        history.replay,
        record.sign,
        record.bundle,
        record.verify,
        jobs.adopt,
        prune.prune,
    ),
    "Calibrations": (
        calibrations.results,
        calibrations.accept,
        calibrations.reject,
        calibrations.rollback,
        recover.recover,
        calibrations.acknowledge_ledger,
        place.place,
        audit.audit,
        export.export,
    ),
    "This computer": (service.install, service.uninstall),
    "Without a cell": (offline.solve, setup.explain, manual.man, plc_files.plc_files),
}


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(software())
        raise typer.Exit


@app.callback()
def _every_command(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and end.")
    ] = False,
) -> None: ...


for panel, commands in PANELS.items():
    for command in commands:
        app.command(rich_help_panel=panel)(command)
app.command("import", rich_help_panel="Without a cell")(importing.import_data)
app.add_typer(poses.pose_app, name="pose", rich_help_panel="Start here")
app.add_typer(setup.config_app, name="config", rich_help_panel="Without a cell")
