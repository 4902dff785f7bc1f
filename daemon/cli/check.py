"""``cellward check``: is the configuration right, what can be expected of it, and do the devices answer?"""

import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import CellError, error
from daemon.cli.failures import BAD_INPUT
from daemon.cli.options import DEFAULT_CONFIG, ConfigOption, JsonOption, config_path
from daemon.cli.output import out, out_json, say, terminal_width
from procedures.words import table


def check(
    probe: Annotated[
        bool,
        typer.Option("--probe", help="Also open each device: no motion, no touch of the arm's program."),
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            help="With --probe: write every byte of five seconds into this new folder (docs/recordings.md).",
        ),
    ] = None,
    machine: Annotated[
        bool,
        typer.Option("--machine", help="Also measure this machine for three seconds: lag, priority, disk."),
    ] = False,
    drivers: Annotated[
        bool, typer.Option("--drivers", help="List the drivers, also of installed packages, and end.")
    ] = False,
    jobs: Annotated[
        bool, typer.Option("--jobs", help="List the jobs, also of installed packages, and end.")
    ] = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check the configuration (every finding at once), and predict what the jobs can reach.

    Exit code 2 when a job cannot succeed with it; a warning alone changes nothing.
    """
    from daemon.cli.arm_model import arm_in_use, strangers
    from daemon.cli.machine import low_space
    from daemon.cli.machine import machine as measure
    from daemon.config import load_config
    from daemon.disk_space import capture_bytes
    from daemon.predictions import found_in, named, predictions
    from daemon.service.network import not_permitted
    from daemon.tool_references import without_reference
    from daemon.words.program_after_text import program_after_words

    if drivers or jobs:
        from daemon.cli.installed import list_installed

        return list_installed(drivers, jobs, as_json)
    if record is not None and not probe:
        raise error("ARGUMENT_INVALID", "--record writes down what --probe does; give both")
    path, valid = config or DEFAULT_CONFIG, False
    try:
        loaded = load_config(config_path(config))
        valid = True
        expected, arm, absent = predictions(loaded), arm_in_use(loaded), without_reference(loaded)
    except CellError as exc:
        if as_json:
            out_json({"config": str(path), "valid": valid, **_as_findings(path, exc)})
        raise
    line_at = _lines_of(loaded.source)
    problems = [*loaded.problems, *_not_told_yet(found_in(expected, "problems", line_at), loaded.problems)]
    doubts = [f"arm: {text}" for text in arm["cautions"]] if arm else []
    doubts += absent
    full = low_space(loaded)
    barred = not_permitted(loaded) if loaded.source == str(DEFAULT_CONFIG) else []
    cautions = found_in(expected, "cautions", line_at)
    warnings = [*loaded.warnings, *doubts, *cautions, *([full] if full else []), *barred]
    for problem in problems:
        say(f"Error: {problem}")
    for warning in warnings:
        say(f"Warning: {warning}")
    found = _probe(loaded, record) if probe else []
    measured = measure(Path(loaded.cell.state_dir), capture_bytes(loaded)) if machine else []
    serials = {d["device"]: d["serial"] for d in found if d["serial"]}
    for stranger in strangers(loaded, serials) if serials else ():
        warnings.append(stranger)
        say(f"Warning: {stranger}")
    for doubt in (text for one in found for text in one["doubts"]):
        warnings.append(doubt)
        say(f"Warning: {doubt}")
    by_itself = program_after_words(loaded)
    if as_json:
        shown = {
            "config": str(path),
            "valid": True,
            "findings": [],
            "problems": problems,
            "warnings": warnings,
            "arm": arm,
            "program_after": by_itself,
        }
        out_json({**shown, "predictions": expected, "devices": found, "machine": measured})
    else:
        about = f"cell '{loaded.cell.name}', {len(loaded.device)} devices"
        failing = "could be read, but jobs cannot succeed with it" if problems else "is valid"
        out(f"{path} {failing}: {about}")
        if arm is not None:
            out(f"arm: {arm['text']}")
        for job in expected:
            out(_clauses(named(job), job["text"]))
        if by_itself is not None:
            out(_clauses("program_after", by_itself))
        if probe:
            columns = ("device", "answer", "model", "serial")
            out(table(columns, ([d["device"], d["answer"], d["model"], d["serial"]] for d in found)))
        for one in measured:
            out(f"{'machine' if one['good'] else 'machine, look at this'}: {one['text']}")
    bad = [d for d in found if d["exit_code"]]
    if bad:
        say(bad[0]["hint"])
    if problems or bad:
        raise typer.Exit(BAD_INPUT if problems else bad[0]["exit_code"])


def _lines_of(source: str) -> Callable[[tuple[str | int, ...]], str]:
    """``file:line: `` of a key that the file has; nothing of another."""
    from daemon.config.locate import locate

    lines = locate(Path(source).read_text("utf-8-sig"))
    return lambda key: f"{source}:{lines[key]}: " if key in lines else ""


def _not_told_yet(expected: list[str], told: list[str]) -> list[str]:
    """Those of ``expected`` that are not about poses alone which a line of the file named before."""
    named = set(re.findall(r"there is no '([^']+)' in \[poses\]", "\n".join(told)))
    known = {text for text in expected if "[poses]" in text and set() < _poses_of(text) <= named}
    return [text for text in expected if text not in known]


def _poses_of(problem: str) -> set[str]:
    """The poses that a sentence says are missing; the name of its job may have that of a tool."""
    return set(re.findall(r"'([^']+)'", problem.partition(": ")[2]))


def _clauses(job: str, text: str) -> str:
    """A line for each clause of a prediction, broken where a terminal ends that has room for text."""
    width = terminal_width() or 0
    lines = [f"{job}:"]
    for clause in text.split("; "):
        lines += textwrap.wrap(clause, width - 4, subsequent_indent="  ") if width > 40 else [clause]
    return "\n  ".join(lines)


def _as_findings(path: Path, exc: CellError) -> dict[str, Any]:
    """Why the file cannot be used: ``error``, and each finding with ``line``, ``key`` and ``text``."""
    found = []
    for sentence in getattr(exc, "findings", None) or [str(exc)]:
        rest = sentence.removeprefix(f"{path}:")
        parts = re.fullmatch(r"(\d+): (?:([\w.\[\]-]+): )?(.*)", rest, re.DOTALL)
        line, key, text = parts.groups() if parts else (None, None, rest.strip())
        found.append({"line": int(line) if line else None, "key": key, "text": text})
    return {"error": exc.as_dict(), "findings": found, "problems": [], "warnings": []}


def _probe(config: Any, record: Path | None) -> list[dict[str, Any]]:
    import asyncio

    from daemon.cli.probe import probe_devices

    return asyncio.run(probe_devices(config, record))
