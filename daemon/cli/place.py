"""``cellward place``: where the target is on the flange, for the check of a fixed camera."""

from dataclasses import asdict
from typing import Annotated

import typer

from cell.errors import error
from daemon.cli.options import ConfigOption, JsonOption, cell_paths
from daemon.cli.output import out, out_json, say

JOB = "eye-to-hand-check"


def place(
    run: Annotated[
        int,
        typer.Argument(
            help='Run of a cone-capture, setup = "eye-to-hand", with the target as it is mounted now.',
            show_default=False,
        ),
    ],
    placement: Annotated[
        str | None, typer.Option("--placement", help="Of that capture; its last one unless given.")
    ] = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    r"""The target's place on the flange by a capture, as lines for \[job.eye-to-hand-check]."""
    from daemon.cli.history import load, result_of
    from daemon.config import load_config
    from procedures.documents import read_result
    from procedures.eye_to_hand.taken_over import taken_over

    cell = load_config(cell_paths(config).config)
    folder = load(config, run)
    if (end := folder.read_end()) is not None and end.get("verdict") == "altered":
        raise error("DATA_INVALID", f"the result of run {run} was altered after the run's end")
    result = read_result(result_of(folder), f"the result of run {run}")
    found = taken_over(result, cell.target, cell.job.get(JOB, {}).get("target"), placement)
    if as_json:
        out_json(asdict(found))
        return
    say(
        f"Of placement {found.placement}. It holds while the target stays as it is mounted. What the capture "
        "and a hand-eye that was made with it have wrong alike, such a check does not see."
    )
    numbers = ", ".join(f"{v:.7g}" for v in found.T_marker_flange)
    out(f"[job.{JOB}]")
    out(f'target = "{found.target}"')
    out(f"T_marker_flange = [{numbers}]")
    out(f"place_sigma_t_m = {found.sigma_t_m:.3g}")
    out(f"place_sigma_r_rad = {found.sigma_r_rad:.3g}")
    out('place_from = "hand-eye"')
