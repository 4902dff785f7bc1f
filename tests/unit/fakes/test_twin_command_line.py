"""The folder that ``cellward-twin`` asks a twin in, and the page that tells how to play a cell by hand."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fakes import cli


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (["tool", "straighten", "--out", "/second"], [Path("/second")]),
        (["tool", "straighten"], [cli.default_folder()]),
        (["--out", "/second", "tool", "straighten"], []),
        (["--out", "/second", "truth"], []),
    ],
)
def test_no_other_twin_is_asked_than_the_one_that_is_named(
    monkeypatch: pytest.MonkeyPatch, words: list[str], asked: list[Path]
) -> None:
    seen: list[Path] = []

    def ask(folder: Path, _request: Any) -> dict[str, Any]:
        seen.append(folder)
        return {}

    monkeypatch.setattr(cli, "ask", ask)
    result = CliRunner().invoke(cli.app, words)
    assert seen == asked
    assert result.exit_code == (0 if asked else 2)
    assert asked or "belongs behind the command" in " ".join(result.output.replace("│", " ").split())


def test_the_page_confirms_what_its_jobs_ask() -> None:
    page = (Path(__file__).parents[3] / "docs" / "twin.md").read_text("utf-8")
    lines = page.partition("export CELLWARD_CONFIG")[2].partition("```")[0].splitlines()
    started = {line.split()[2]: next_line for line, next_line in pairwise(lines) if " start laser-" in line}
    asks = {job: next_line.startswith("cellward confirm ID") for job, next_line in started.items()}
    assert asks == {"laser-reference": True, "laser-check": False, "laser-update": True}
    (automatic,) = [line for line in page.splitlines() if "--operator auto" in line]
    assert "`cellward confirm ID` remains for you" in automatic


@pytest.mark.parametrize(
    "words", [["--scenario", "laser"], ["--ideal"], ["--bind", "127.0.0.2"], ["--operator", "auto"]]
)
def test_what_starts_a_twin_is_refused_before_a_command_that_starts_none(words: list[str]) -> None:
    result = CliRunner().invoke(cli.app, [*words, "scenarios"])
    assert result.exit_code == 2
    assert f"{words[0]}: it is for starting a twin, and 'scenarios' starts none" in " ".join(
        result.output.replace("│", " ").split()
    )
