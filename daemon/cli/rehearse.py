"""``cellward rehearse``: a job on a twin of this very cell, before anything real moves."""

import logging
import shutil
from pathlib import Path
from typing import Annotated

import typer

from cell.errors import CellError
from daemon.cli.failures import FAILED
from daemon.cli.options import ConfigOption, JsonOption, config_path
from daemon.cli.output import out, out_json, say

LIMITS = (
    "The sizes of the twin's imperfections are usual ones, not this cell's own: light, cables, people, "
    "networks and wear are not in it."
)
STATE = "state"


def rehearse(
    job: Annotated[str, typer.Argument(help=r"The job, as its section \[job.NAME] is called.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws the first twin.")] = 1,
    times: Annotated[int, typer.Option("--times", min=1, max=1000, help="So many twins, one by one.")] = 1,
    tool: Annotated[str | None, typer.Option("--tool", help="The tool, where the cell has several.")] = None,
    output: Annotated[Path, typer.Option("--out", help="Folder for the files.")] = Path("rehearsal-out"),
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a job on a twin made from the configuration: does it end, how long, how accurate, what falls out?

    Nothing real is opened or moved. Each twin has the nominal places of the configuration with usual errors
    around them. Exit code 1 when the job does not end well in one of them.
    """
    from daemon.config import load_config
    from daemon.demo.folder import begin_in
    from daemon.rehearsal.objects import rehearsal_reference
    from daemon.rehearsal.play import rehearse as play
    from daemon.rehearsal.words import outcome_lines, summary_lines, twin_lines

    path = config_path(config)
    loaded = load_config(path)
    rehearsal_reference(job)
    outcomes = []
    say(f"Rehearsing {job} of cell '{loaded.cell.name}' on a twin of it; nothing real is opened or moved.")
    for number in range(seed, seed + times):
        folder = (output / f"{job}-{number}").absolute()
        made = [f for f in (folder, output) if not f.exists()]  # by this rehearsal
        begin_in(folder, STATE, "rehearsal")
        logging.basicConfig(filename=folder / "rehearsal.log", level=logging.INFO, force=True)
        try:
            outcome = play(loaded, path, job, number, folder, tool)
        except CellError:  # refused before anything was played
            if made:
                shutil.rmtree(made[-1])
            raise
        outcomes.append(outcome)
        if not as_json:
            for line in outcome_lines(job, outcome):
                out(line)
    if as_json:
        out_json({"job": job, "config": str(path), "rehearsals": [o.as_dict() for o in outcomes]})
    else:
        for line in summary_lines(job, outcomes):
            out(line)
        for line in twin_lines(outcomes):
            out(line)
        out(LIMITS)
    if not all(outcome.succeeded for outcome in outcomes):
        raise typer.Exit(FAILED)
