"""The manual's generated pages are what the code says today."""

import json
import tomllib
from pathlib import Path

import pytest

from cell.errors import catalogue
from daemon.config import DRIVERS, init_text
from daemon.docs import generated, stale
from daemon.modbus import register_table
from procedures.registry import JOBS


def test_no_generated_page_is_stale() -> None:
    assert stale(JOBS) == [], "run 'make docs' and commit what it writes"


def test_a_page_that_was_edited_or_lost_is_found(tmp_path: Path) -> None:
    for name, text in generated(JOBS).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    assert stale(JOBS, tmp_path) == []
    (tmp_path / "docs/errors.md").write_text("edited")
    (tmp_path / "docs/registers.md").unlink()
    assert sorted(stale(JOBS, tmp_path)) == ["docs/errors.md", "docs/registers.md"]


def test_every_register_bit_and_value_is_in_the_manual() -> None:
    page = generated(JOBS)["docs/registers.md"]
    table = register_table()
    for register in (*table.command, *table.status):
        assert f"`{register.name}`" in page
        for text in (*register.values.values(), *register.bits):
            assert f"| {text} |" in page


def test_every_error_is_in_the_manual_once() -> None:
    page = generated(JOBS)["docs/errors.md"]
    for entry in catalogue().values():
        assert page.count(f"| {entry.code} | `{entry.name}` |") == 1


@pytest.mark.parametrize("job", sorted(JOBS))
def test_every_job_has_its_number_in_the_register_table_and_a_state_diagram(job: str) -> None:
    numbers = next(r for r in register_table().command if r.name == "job").values
    assert numbers[JOBS[job].number] == job
    assert f"## {JOBS[job].number} {job}\n" in generated(JOBS)["docs/jobs.md"]


def test_the_schema_knows_every_key_of_the_example() -> None:
    schema = json.loads(generated(JOBS)["docs/cell.schema.json"])
    example = tomllib.loads(init_text())
    assert example.keys() <= schema["properties"].keys()
    assert schema["additionalProperties"] is False
    definitions = schema["$defs"]

    def resolved(entry: dict[str, object]) -> dict[str, object]:
        return definitions[str(entry["$ref"]).rpartition("/")[2]] if "$ref" in entry else entry

    for name in ("cell", "robot", "limits", "modbus"):
        assert example[name].keys() <= resolved(schema["properties"][name])["properties"].keys()
    drivers = {
        resolved(choice)["properties"]["driver"].get("const"): resolved(choice)["properties"]
        for choice in schema["properties"]["device"]["additionalProperties"]["anyOf"]
    }
    assert drivers.keys() >= set(DRIVERS)
    for section in example["device"].values():
        assert section.keys() <= drivers[section["driver"]].keys()
    for name, section in example["job"].items():
        assert (
            section.keys() <= resolved(schema["properties"]["job"]["properties"][name])["properties"].keys()
        )
