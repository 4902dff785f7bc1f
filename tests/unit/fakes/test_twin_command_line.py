"""The folder that ``cellward-twin`` asks a twin in."""

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
