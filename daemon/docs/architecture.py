"""``docs/architecture.md``: the packages, who may import whom by the import contracts, and their rooms."""

import ast
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from daemon.docs.page import cell, page

HEAD = """
# Architecture

Source: the import contracts in `pyproject.toml`, which `make lint` checks, and the first sentence of each
package.

An arrow says that a package may import another one; what is reached over several arrows may be imported,
too. A device driver knows the contract in `cell/` and nothing else, so it can come from anybody; the twin
in `fakes/` knows the same contract, so a driver and its counterpart share no code that could be wrong
twice. A job is one folder in `procedures/`, and `procedures/kind.py` says what it plugs in: data file,
solver, words, report, comparison and expectation. The mathematics in `calibration/` takes arrays and reads
no file. `daemon/` puts all of it together.

A run passes through them like this: a PLC's command comes to `daemon/modbus`, `daemon/plc.py` hands it to
`daemon/engine.py`, which resolves the values of the run (`cell/run_values.py`) and starts the job's coroutine
with a `Run` (`cell/procedure.py`). The job moves the arm through the motion lease (`cell/motion.py`),
writes raw data to the run folder (`cell/store/`), and has its data set solved in a worker process. The
engine enters what it proposes into the ledger, where a person or a policy accepts it.
"""


def architecture_page(root: Path) -> str:
    """The text of ``docs/architecture.md`` for the repository at ``root``."""
    settings = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    packages: list[str] = settings["root_packages"]
    lines = ["```mermaid", "flowchart TD"]
    lines += [f'    {name}["<b>{name}/</b><br/>{_sentence(root / name)}"]' for name in packages]
    lines += [f"    {upper} --> {lower}" for upper, lower in arrows(packages, settings["contracts"])]
    lines += ["```", "", "Contracts:", ""]
    lines += [f"- {contract['name']}" for contract in settings["contracts"]]
    for name in packages:
        rooms = sorted(p.parent for p in (root / name).glob("*/__init__.py"))
        lines += ["", f"## {name}/", "", _sentence(root / name), ""]
        if rooms:
            lines += ["| room | what it is for |", "|---|---|"]
            lines += [f"| `{room.relative_to(root)}/` | {cell(_sentence(room))} |" for room in rooms]
    return page(HEAD, lines)


def arrows(packages: Sequence[str], contracts: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """``(importer, imported)`` as the contracts allow it, without those that follow from two others."""
    layers = [
        [name.strip() for name in layer.split(":")]
        for contract in contracts
        if contract["type"] == "layers"
        for layer in contract["layers"]
    ]
    floor = {name: k for k, layer in enumerate(layers) for name in layer if name in packages}
    forbidden = {
        (source, target)
        for contract in contracts
        if contract["type"] == "forbidden" and not contract.get("allow_indirect_imports")
        for source in contract["source_modules"]
        for target in contract["forbidden_modules"]
    }
    allowed = {
        (upper, lower)
        for upper in packages
        for lower in packages
        if upper != lower and (upper, lower) not in forbidden and floor.get(upper, -1) < floor.get(lower, -1)
    }
    return sorted(pair for pair in allowed if not any(_by_way_of(pair, allowed, packages)))


def _by_way_of(
    pair: tuple[str, str], allowed: set[tuple[str, str]], packages: Sequence[str]
) -> Iterator[bool]:
    upper, lower = pair
    for between in packages:
        yield (upper, between) in allowed and (between, lower) in allowed


def _sentence(folder: Path) -> str:
    """The first sentence of a package's docstring."""
    words = ast.get_docstring(ast.parse((folder / "__init__.py").read_text("utf-8"))) or ""
    return words.splitlines()[0].replace("``", "`")
