"""What a trivial job of our own costs: ``python tests/job_cost.py FOLDER`` copies the tree and adds one.

The job is that of docs/examples/acme, in one folder. Printed are the lines that shared files get.
"""

import difflib
import shutil
import sys
from pathlib import Path

TREE = Path(__file__).parents[1]
COPIED = ("cell", "calibration", "procedures", "daemon", "drivers", "fakes", "tests/kit")
CONTRACTS = "pyproject.toml"
NAME, NUMBER, MODULE = "still", 15, "procedures.still"
SHARED = {  # the line before which one is put, and that one
    "procedures/kind.py": (
        ")\nKINDS:",
        f'    Kind(name="{NAME}", module="{MODULE}", words=":lines", '
        'result=":StillResult", jobs=(":Still",)),\n',
    ),
    "daemon/modbus/registers.toml": ("\n[[command]]\naddress = 3\n", f'{NUMBER} = "{NAME}"\n'),
    CONTRACTS: ("    | touch_test\n", f"    | {NAME}\n"),
}


def add_trivial_job(tree: Path) -> dict[str, int]:
    """Copy the tree to ``tree`` and add the job; how many lines each file has more or changed."""
    for name in COPIED:
        shutil.copytree(TREE / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(TREE / CONTRACTS, tree)
    (tree / "procedures" / NAME).mkdir()
    (tree / "procedures" / NAME / "__init__.py").write_text(job_source(), "utf-8")
    for name, (before, line) in SHARED.items():
        text = (tree / name).read_text("utf-8")
        assert text.count(before) == 1, f"{name} has no single {before!r}"
        (tree / name).write_text(text.replace(before, line + before), "utf-8")
    return {name: changed(TREE / name, tree / name) for name in SHARED}


def job_source() -> str:
    """The job of the example as one of ours: its kind is an entry of the table and no object beside it."""
    text = (TREE / "docs/examples/acme/acme_belt/still.py").read_text("utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("KIND = ", "from procedures.kind"))]
    text = "\n".join(lines) + "\n"
    named = '"acme-still", 1001, KIND.name'
    assert named in text
    return (
        text.replace(named, f'"{NAME}", {NUMBER}, "{NAME}"')
        .replace("acme-still", NAME)
        .replace("BeltStill", "Still")
    )


def changed(before: Path, after: Path) -> int:
    """Lines of ``after`` that ``before`` does not have."""
    lines = difflib.ndiff(before.read_text("utf-8").splitlines(), after.read_text("utf-8").splitlines())
    return sum(line.startswith("+ ") for line in lines)


def main(folder: Path) -> None:
    costs = add_trivial_job(folder)
    print(f"{'new folder':32}{len(job_source().splitlines()):4} lines: procedures/{NAME}")
    for name, lines in costs.items():
        print(f"{name:32}{lines:4} line{'s' * (lines != 1)}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("give the folder that the copy of the tree goes to: python tests/job_cost.py FOLDER")
    main(Path(sys.argv[1]))
