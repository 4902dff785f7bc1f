"""``cellward export``: a calibration in the form of another program, or the store as tables."""

from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.damaged import reading
from daemon.cli.options import CellPaths, ConfigOption, cell_paths
from daemon.cli.output import out, say

FORMATS = ("urscript", "ros", "urdf", "yaml", "json", "ur-calibration")
_FITS = {
    "pose": ("urscript", "ros", "urdf", "yaml", "json"),
    "kinematics": ("ros", "urdf", "yaml", "json", "ur-calibration"),
    "other arm": ("urdf", "yaml", "json"),
    "value": ("yaml", "json"),
}
_WHY_NOT = {
    ("pose", "ur-calibration"): "is a pose, and ur-calibration holds an arm's kinematics",
    ("kinematics", "urscript"): "is an arm's kinematics, which URScript cannot set",
    ("kinematics", "ros"): "is not of a Universal Robots arm, whose ROS description ros is for",
    ("kinematics", "ur-calibration"): "is not of a Universal Robots arm, whose table ur-calibration is",
}
SCHEMA = "cellward.export/1"


def export(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A calibration in effect (T_flange_camera, T_base_camera, T_flange_tool.TOOL, "
            "kinematics.DEVICE), or a result file.",
            show_default=False,
        ),
    ] = None,
    form: Annotated[
        str | None, typer.Option("--format", "-f", help=f"{', '.join(FORMATS)}.", show_default=False)
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write to this file instead of to the terminal.")
    ] = None,
    parquet: Annotated[
        Path | None,
        typer.Option(
            "--parquet",
            metavar="FILE",
            help="Instead: all runs and results as the tables FILE.runs.parquet and FILE.results.parquet.",
            show_default=False,
        ),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            "--mcap",
            metavar="FILE",
            help="Instead: the run whose number is given as NAME, as a recording that Foxglove opens.",
            show_default=False,
        ),
    ] = None,
    config: ConfigOption = None,
) -> None:
    """A calibration in effect for another program: with its direction, version, date and uncertainty.

    Or, with --parquet, every run and result of the cell for the tools of a plant; with --mcap, one run.
    """
    if mcap is not None:
        if form or output or parquet:
            raise error("ARGUMENT_INVALID", "--mcap is of one run: leave out -f, -o and --parquet")
        return _recording(name, mcap, cell_paths(config))
    if parquet is not None:
        if name or form or output:
            raise error("ARGUMENT_INVALID", "--parquet is of the whole store: leave out NAME, -f and -o")
        return _tables(parquet, cell_paths(config))
    if name is None:
        raise error("ARGUMENT_INVALID", "give NAME and --format, or --parquet FILE for the whole store")
    if form is not None and form not in FORMATS:
        near = get_close_matches(form, FORMATS, n=1)
        fix = f"did you mean {near[0]}?" if near else f"there is {', '.join(FORMATS)}"
        raise error("ARGUMENT_INVALID", f"--format {form} is not known; {fix}")
    if output is not None:
        _require_folder(output)
    from daemon.cli.export_source import from_file, from_ledger

    path = Path(name)
    is_path = path.suffix == ".json" or len(path.parts) > 1 or path.is_dir()
    if is_path:
        with reading(path):
            exported = from_file(path)
            text = written(exported, form)
    else:
        exported = from_ledger(name, cell_paths(config))
        text = written(exported, form)
    for warning in exported.warnings:
        say(f"Warning: {warning}")
    if output is None:
        out(text.rstrip("\n"))
        return
    from cell.store.files import write_atomic

    write_atomic(output, text)
    say(f"{exported.name} is in {output}.")


def _require_folder(file: Path) -> None:
    if not (folder := file.absolute().parent).is_dir():
        raise error("ARGUMENT_INVALID", f"{file}: the folder {folder} does not exist")


def _recording(name: str | None, file: Path, paths: CellPaths) -> None:
    if name is None:
        raise error("ARGUMENT_INVALID", "--mcap is of one run: give its number")
    if not name.isascii() or not name.isdigit():
        raise error("ARGUMENT_INVALID", f"'{name}' is no number of a run; 'cellward runs' lists them")
    _require_folder(file)
    from cell.store.runs import load_run
    from daemon.cli.run_mcap import write_mcap

    folder = load_run(paths.runs, int(name))
    with reading(folder.path):
        counts = write_mcap(folder, file)
    say(f"{file} has {sum(counts.values())} messages in {len(counts)} topics.")


def _tables(file: Path, paths: CellPaths) -> None:
    _require_folder(file)
    from daemon.cli.store_tables import write_tables

    for path, lines in write_tables(paths, file):
        say(f"{path} has {lines} lines.")


def written(exported: Any, form: str | None) -> str:
    """The text of the file; ``ARGUMENT_INVALID`` for a form that makes no sense for this calibration, or for
    none."""
    kind = "other arm" if exported.kind == "kinematics" and exported.ur_model is None else exported.kind
    fits = ", ".join(_FITS[kind])
    if form is None:
        raise error("ARGUMENT_INVALID", f"give --format for {exported.name}; it can be exported as {fits}")
    if form not in _FITS[kind]:
        why = _WHY_NOT.get((exported.kind, form), "is neither a pose nor an arm's kinematics")
        raise error("ARGUMENT_INVALID", f"{exported.name} {why}; it can be exported as {fits}")
    if form == "json":
        from cell.store.files import to_json

        return to_json(document(exported), indent=1) + "\n"
    if form == "yaml":
        return _yaml(header(exported), document(exported))
    from daemon.cli import export_arm, export_pose

    of_arm = exported.kind == "kinematics"
    if form == "ros":
        comments, content = (export_arm if of_arm else export_pose).ros(exported)
        return _yaml([*header(exported), *comments], content, leaves_in_a_row=False)
    if form == "urdf":
        comments, xml = export_arm.urdf(exported) if of_arm else ([], export_pose.urdf(exported))
        return _with_comments(xml, [*header(exported), *comments])
    if form == "ur-calibration":
        comments, lines = export_arm.ur_calibration(exported)
    else:
        comments, lines = [], export_pose.urscript(exported)
    return "\n".join([*_commented([*header(exported), *comments]), *lines, ""])


def header(exported: Any) -> list[str]:
    """What every file says of itself: direction, version, date, uncertainty, units."""
    version = "no committed version" if exported.version is None else f"version {exported.version}"
    meaning = f": {exported.direction}" if exported.direction else ""
    if exported.frames is not None:
        parent, child = exported.frames
        meaning += f" (p_{parent} = T_{parent}_{child} p_{child})"
    lines = [
        f"Cellward calibration {exported.name}{meaning}",
        f"{version}, {exported.date}, {exported.source}",
        exported.told,
        *_load(exported),
        *(f"WARNING: {warning}" for warning in exported.warnings),
        "metres and radians",
    ]
    return [" ".join(line.split()) for line in lines]


def _load(exported: Any) -> list[str]:
    """An arm bends: what was measured under one load is not so under another."""
    if exported.payload_kg is None:
        return []
    return [f"measured with {exported.payload_kg:g} kg on the flange, and holds for that load"]


def document(exported: Any) -> dict[str, Any]:
    """The calibration as one document of plain values."""
    content: dict[str, Any] = {"schema": SCHEMA, "name": exported.name}
    if exported.direction:
        content["direction"] = exported.direction
    content |= {
        "version": exported.version,
        "date": exported.date,
        "source": exported.source,
        "uncertainty": {**exported.uncertainty, "meaning": exported.told},
        "warnings": exported.warnings,
    }
    if exported.kind == "kinematics":
        return content | {
            "model": exported.model,
            "payload_kg": exported.payload_kg,
            "robot": exported.robot,
        }
    if exported.frames is None:
        return content | {"value": exported.value}
    from daemon.cli.export_pose import quaternion

    return content | {
        "parent": exported.frames[0],
        "child": exported.frames[1],
        "pose": [float(v) for v in exported.value],
        "pose_is": "x, y, z in metres, then the rotation vector in radians",
        "quaternion_xyzw": quaternion(exported),
    }


def _commented(lines: list[str]) -> list[str]:
    return [f"# {' '.join(line.splitlines())}" for line in lines]


def _yaml(comments: list[str], content: Any, leaves_in_a_row: bool = True) -> str:
    import yaml

    flow = None if leaves_in_a_row else False
    body = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=flow, width=110)
    return "\n".join([*_commented(comments), body])


def _with_comments(xml: str, comments: list[str]) -> str:
    """``xml`` with a comment behind its first line; two hyphens in a row would end it early."""
    first, _, rest = xml.partition("\n")
    inside = "\n".join(f"  {line.replace('--', '- -')}" for line in comments)
    return f"{first}\n<!--\n{inside}\n-->\n{rest}"
