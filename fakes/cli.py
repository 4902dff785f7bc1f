"""``cellward-twin``: the twin of a cell, its faults, its truth and its operator."""

import json
import os
import signal
import sys
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from cell.collector import without_collector
from cell.errors import CellError, Reaction
from fakes.twin.control import ask, default_folder
from fakes.wire.lifetime import die_with_parent

if TYPE_CHECKING:
    from fakes.twin.serve import Twin

EXIT_BAD_INPUT, EXIT_UNREACHABLE, EXIT_REFUSED, EXIT_INTERNAL = 2, 3, 4, 5
_EXIT_CODES = {
    Reaction.INPUT: EXIT_BAD_INPUT,
    Reaction.RETRY: EXIT_UNREACHABLE,
    Reaction.ABORT: EXIT_UNREACHABLE,
    Reaction.REFUSE: EXIT_REFUSED,
    Reaction.LATCH: EXIT_REFUSED,
    Reaction.INTERNAL: EXIT_INTERNAL,
}

app = typer.Typer(add_completion=False, no_args_is_help=True)
operator_app = typer.Typer(help="What the operator does in the running twin.", no_args_is_help=True)
app.add_typer(operator_app, name="operator")
tool_app = typer.Typer(help="What happens to the tool in the running twin.", no_args_is_help=True)
app.add_typer(tool_app, name="tool")
out, err = Console(), Console(stderr=True)

Folder = Annotated[
    Path,
    typer.Option(
        "--out", help="Folder of the twin's sockets and its cell.toml.", default_factory=default_folder
    ),
]


@app.callback(invoke_without_command=True)
def twin(
    context: typer.Context,
    folder: Folder,
    scenario: Annotated[
        str | None,
        typer.Option(help="Scenario file, or a shipped one's name; 'scenarios' lists them."),
    ] = None,
    bind: Annotated[str | None, typer.Option(help="Loopback address of the arm, e.g. 127.0.0.2.")] = None,
    operator: Annotated[str, typer.Option(help="manual, or auto: moves the target on by itself.")] = "manual",
    ideal: Annotated[
        bool, typer.Option("--ideal", help="A kinder world than any cell; the same as SCENARIO:ideal.")
    ] = False,
    with_parent: Annotated[bool, typer.Option(help="End when the starting process ends.")] = False,
) -> None:
    """The twin of a cell on real protocols: serves SCENARIO until Ctrl-C or SIGTERM.

    It writes a cell.toml for 'cellward run' into its folder, and prints where.
    """
    if (command := context.invoked_subcommand) is not None:
        _refuse_before(command, context, folder)
        return
    if scenario is None:
        from fakes.world.scenario import shipped_scenarios

        known = ", ".join(shipped_scenarios())
        raise typer.BadParameter(f"a scenario is needed: a file, or one of {known}", param_hint="--scenario")
    if bind is not None and not _is_loopback(bind):
        raise typer.BadParameter(f"{bind} is not a loopback address 127.x.y.z", param_hint="--bind")
    if operator not in ("manual", "auto"):
        raise typer.BadParameter(f"{operator} is neither manual nor auto", param_hint="--operator")
    if with_parent:
        die_with_parent(signal.SIGTERM)
    if ideal:
        from fakes.world.scenario import IDEAL_SUFFIX

        scenario += IDEAL_SUFFIX
    _serve(scenario, folder, bind, operator == "auto")


def _refuse_before(command: str, context: typer.Context, folder: Path) -> None:
    """Refuse options that stand before a command: it starts no twin, and has an ``--out`` of its own."""
    for name in context.params:
        source = context.get_parameter_source(name)
        if source is None or source.name != "COMMANDLINE":
            continue
        if name == "folder":
            text = f"it belongs behind the command, as in: cellward-twin {command} ... --out {folder}"
            raise typer.BadParameter(text, param_hint="--out")
        text = f"it is for starting a twin, and '{command}' starts none; leave it out"
        raise typer.BadParameter(text, param_hint=f"--{name.replace('_', '-')}")


@app.command()
def scenarios() -> None:
    """List the shipped scenarios: what --scenario takes by name."""
    from fakes.world.scenario import shipped_descriptions

    said = shipped_descriptions()
    width = max(map(len, said))
    for name, text in said.items():
        lines = wrap(text, 78 - width)
        for k, line in enumerate(lines):
            out.print(f"{name if k == 0 else '':{width}}  {line}", highlight=False, soft_wrap=True)


@app.command()
def fault(
    name: Annotated[str, typer.Argument(help="Fault, or clear; 'list' shows what each device can show.")],
    folder: Folder,
    arguments: Annotated[list[str] | None, typer.Argument(help="key=value, e.g. for_s=2")] = None,
    device: Annotated[str, typer.Option(help="As 'list' names them: arm, camera, beams, ...")] = "arm",
) -> None:
    """Inject a fault into the running twin."""
    if name == "list":
        for owner, names in ask(folder, {"do": "faults"}).items():
            out.print(f"{owner}: {', '.join(names)}")
        return
    args = dict(_key_value(text) for text in arguments or [])
    ask(folder, {"do": "fault", "device": device, "kind": name, "args": args})


@app.command()
def truth(
    folder: Folder,
    as_json: Annotated[bool, typer.Option("--json", help="Everything, as JSON.")] = False,
) -> None:
    """Print what is truly so in the running twin."""
    value: dict[str, Any] = ask(folder, {"do": "truth"})
    if as_json:
        sys.stdout.write(json.dumps(value) + "\n")
        return
    for key, entry in value.items():
        out.print(f"[bold]{key}[/bold]: {json.dumps(entry)}", highlight=False, soft_wrap=True)


@operator_app.command()
def place(
    placement: Annotated[int, typer.Argument(help="Placement of the target, counted from 1.", min=1)],
    folder: Folder,
) -> None:
    """Put the target at a placement."""
    ask(folder, {"do": "operator", "place": placement})


@operator_app.command("next")
def place_next(folder: Folder) -> None:
    """Put the target at the next placement, after the last at the first."""
    out.print(f"placement {ask(folder, {'do': 'operator', 'next': True})}")


@operator_app.command()
def remove(folder: Folder) -> None:
    """Take the target out of the cell."""
    ask(folder, {"do": "operator", "remove": True})


@operator_app.command()
def empty(folder: Folder) -> None:
    """Take out what the gripper holds."""
    held = ask(folder, {"do": "gripper", "empty": True})
    out.print("it held nothing" if held is None else f"item {held}")


@operator_app.command()
def block(folder: Folder) -> None:
    """Put something on the place where items are put down; it is carried off as items are."""
    out.print(f"carried off in {ask(folder, {'do': 'operator', 'block': True}):g} s")


@app.command(context_settings={"ignore_unknown_options": True})  # a negative number is no option
def jog(
    joints: Annotated[str, typer.Argument(help="Joints of the observed arm in rad, as in 0.1,1.5,-1.5,0")],
    folder: Folder,
) -> None:
    """Move the observed arm, as somebody at its pendant would."""
    try:
        q = [float(x) for x in joints.split(",")]
    except ValueError:
        raise typer.BadParameter(f"{joints!r} is not a list of numbers", param_hint="JOINTS") from None
    out.print(f"there in {ask(folder, {'do': 'observed', 'go': q}):.1f} s")


@operator_app.command()
def lock(
    reflector: Annotated[str, typer.Argument(help="Reflector that the tracker is aimed at by hand.")],
    folder: Folder,
) -> None:
    """Aim the tracker at a reflector and let it follow."""
    ask(folder, {"do": "tracker", "lock": reflector})


Metres = Annotated[float, typer.Option(help="Shift of the tool's point in the flange, m.", min=-1, max=1)]
Radians = Annotated[float, typer.Option(help="Turn about this axis of the flange, rad.", min=-3, max=3)]


@tool_app.command()
def bend(
    folder: Folder, dx: Metres = 0.0, dy: Metres = 0.0, dz: Metres = 0.0, rx: Radians = 0.0, ry: Radians = 0.0
) -> None:
    """Bend the tool: its point and its direction, both counted from the nominal tool."""
    pose = ask(folder, {"do": "tool", "bend": [dx, dy, dz, rx, ry, 0.0]})
    out.print(f"T_flange_tool {json.dumps(pose)}", highlight=False, soft_wrap=True)


@tool_app.command()
def straighten(folder: Folder) -> None:
    """Make the tool as nominal."""
    pose = ask(folder, {"do": "tool", "straighten": True})
    out.print(f"T_flange_tool {json.dumps(pose)}", highlight=False, soft_wrap=True)


def _serve(scenario: str, folder: Path, bind: str | None, automatic: bool) -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy reads them, here and in the camera's process
    # Only here: the other commands answer at once without the libraries that a world needs.
    with without_collector():
        from fakes.twin.serve import TwinOptions, serve

    serve(TwinOptions(scenario, folder, bind, automatic), _announce)


def _announce(twin: "Twin") -> None:
    for name, address in twin.addresses().items():
        out.print(f"{name:14} {address}", highlight=False, soft_wrap=True)
    out.print(f"{'config':14} {twin.cell_toml}", highlight=False, soft_wrap=True)
    out.print("ready", highlight=False)


def _is_loopback(address: str) -> bool:
    parts = address.split(".")
    return len(parts) == 4 and parts[0] == "127" and all(p.isdigit() and int(p) < 256 for p in parts)


def _key_value(text: str) -> tuple[str, Any]:
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise typer.BadParameter(f"{text!r} is not key=value")
    for convert in (int, float):  # a serial number must not become 9.9e10
        try:
            return key, convert(value)
        except ValueError:
            continue
    return key, value


def main() -> None:
    """Entry point; a coded error becomes one sentence on stderr and an exit code."""
    os.environ["PYTHONSAFEPATH"] = "1"  # children: no module from the folder we start in
    try:
        app()
    except CellError as exc:
        err.print(f"Error {exc.code}: {exc}", highlight=False, soft_wrap=True)
        err.print(exc.hint, highlight=False, soft_wrap=True)
        raise SystemExit(_EXIT_CODES[exc.reaction]) from None


if __name__ == "__main__":
    main()
