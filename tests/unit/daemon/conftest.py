"""A cell on disk and the command line on it, which most tests of the command line need."""

from pathlib import Path

import pytest

from tests.kit.cli_harness import CellOnDisk, CommandLine


@pytest.fixture
def cell(tmp_path: Path) -> CellOnDisk:
    return CellOnDisk(tmp_path)


@pytest.fixture
def subject(
    cell: CellOnDisk, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    return CommandLine(monkeypatch, capsys, cell.config)
