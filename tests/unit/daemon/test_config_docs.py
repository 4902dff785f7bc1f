"""The manual's generated pages are what the code says today."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from cell.errors import catalogue
from cell.kinds import plays
from daemon.config import DRIVERS, driver_class, init_text
from daemon.config.not_in_version import JOBS as JOBS_OF_LATER_VERSIONS
from daemon.config.roles import ROLES
from daemon.docs import generated, stale
from daemon.modbus import register_table
from daemon.modbus.pdu import _FUNCTIONS
from procedures.registry import JOBS
from tests.kit.solved import solve_laser


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    """Drawn once for all tests that read them."""
    return generated(JOBS)


def test_no_generated_page_is_stale(pages: dict[str, str]) -> None:
    assert stale(pages) == [], "run 'make docs' and commit what it writes"


def test_a_page_that_was_edited_or_lost_is_found(tmp_path: Path, pages: dict[str, str]) -> None:
    for name, text in pages.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    assert stale(pages, tmp_path) == []
    (tmp_path / "docs/errors.md").write_text("edited")
    (tmp_path / "docs/registers.md").unlink()
    assert sorted(stale(pages, tmp_path)) == ["docs/errors.md", "docs/registers.md"]


def test_every_register_bit_and_value_is_in_the_manual(pages: dict[str, str]) -> None:
    page = pages["docs/registers.md"]
    table = register_table()
    for register in (*table.command, *table.readable):
        assert f"`{register.name}`" in page
        for text in (*register.values.values(), *register.bits):
            assert f"| {text} |" in page


def test_the_manual_says_when_each_status_bit_is_set_and_which_functions_there_are(
    pages: dict[str, str],
) -> None:
    page = pages["docs/registers.md"]
    said = page.split("## What the status says\n")[1].split("\n## ")[0]
    firsts = (line.split("|")[1] for line in said.splitlines() if line.startswith("| `"))
    told = {name for first in firsts for name in re.findall(r"`([^`]+)`", first)}
    register = next(r for r in register_table().status if r.name == "status")
    assert told == {text for text in register.bits if not text.startswith(("reserved", "toggles"))}
    refused = {1, 5, 15}  # there are no coils
    functions = re.search(r"^Functions: (.*), and (\d+)/14", page, re.MULTILINE)
    assert functions is not None
    assert {*map(int, functions[1].split(", ")), int(functions[2])} == _FUNCTIONS.keys() - refused


def test_every_error_is_in_the_manual_once(pages: dict[str, str]) -> None:
    page = pages["docs/errors.md"]
    for entry in catalogue().values():
        assert page.count(f"| {entry.code} | `{entry.name}` |") == 1


@pytest.mark.parametrize("job", sorted(JOBS))
def test_every_job_has_its_number_in_the_register_table_and_a_state_diagram(
    job: str, pages: dict[str, str]
) -> None:
    numbers = next(r for r in register_table().command if r.name == "job").values
    assert numbers[JOBS[job].number] == job
    assert f"## {JOBS[job].number} {job}\n" in pages["docs/jobs.md"]


def test_the_schema_knows_every_key_of_the_example(pages: dict[str, str]) -> None:
    schema = json.loads(pages["docs/cell.schema.json"])
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


def test_what_this_version_does_not_have_is_in_no_manual_and_in_no_example(pages: dict[str, str]) -> None:
    for name in JOBS_OF_LATER_VERSIONS:
        assert not [page for page, text in pages.items() if name in text]


@pytest.mark.parametrize("driver", sorted(DRIVERS))
def test_every_driver_says_which_kind_of_device_it_is(driver: str) -> None:
    assert any(plays(driver_class(driver), role.protocol) for role in ROLES.values())


def test_the_status_bits_of_the_roles_are_those_of_the_register_table() -> None:
    table = register_table()
    numbers = {"arm": 7, "flange_camera": 8, "fixed_camera": 8, "belt": 9, "beams": 10, "tracker": 11}
    bits = {name: table.bit("status", r.status_bit) for name, r in ROLES.items() if r.status_bit is not None}
    assert bits == {name: 1 << number for name, number in numbers.items()}


def rows_of(page: str, section: str) -> dict[str, list[str]]:
    part = page.split(f"## {section}\n")[1].split("\n## ")[0]
    rows = [re.split(r"(?<!\\)\|", line) for line in part.splitlines() if line.startswith("| `")]
    return {row[1].strip().strip("`"): [cell.strip() for cell in row[2:]] for row in rows}


def test_the_manual_has_the_defaults_of_a_table_where_it_is_used(pages: dict[str, str]) -> None:
    page = pages["docs/config.md"]
    rows = rows_of(page, "[job.laser-check]")
    made = JOBS["laser-check"].Config().against_last
    assert rows["against_last.max_shift_m"][1] == f"`{made.max_shift_m:g}`"
    assert rows["against_last.max_tilt_rad"][1] == f"`{made.max_tilt_rad:g}`"
    schema = json.loads(pages["docs/cell.schema.json"])
    check = schema["$defs"]["LaserCheckConfig"]["properties"]
    assert check["against_last"]["default"]["max_shift_m"] == made.max_shift_m


def test_required_and_optional_keys_can_be_told_apart(pages: dict[str, str]) -> None:
    rows = rows_of(pages["docs/config.md"], '[device.NAME] with driver = "ur"')
    assert (rows["host"][1], rows["expect_serial"][1]) == ("**required**", "none")
    assert all(row[1] for row in rows.values())


def test_every_key_of_the_configuration_has_a_meaning(pages: dict[str, str]) -> None:
    page = pages["docs/config.md"]
    rows = [re.split(r"(?<!\\)\|", line) for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) > 300
    assert [row[1].strip() for row in rows if not row[5].strip()] == []


def test_the_manual_of_the_configuration_points_to_no_file_that_is_not_there(pages: dict[str, str]) -> None:
    for name in ("docs/config.md", "docs/cell.schema.json"):
        assert "FORMATS" not in pages[name]


def test_the_figures_of_the_laser_example_are_those_of_the_program(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "data-sets.md").read_text("utf-8")
    at = page.index('"schema": "cellward.laser/1"')
    start = page.rindex("```json", 0, at) + len("```json")
    (tmp_path / "laser.json").write_text(page[start : page.index("```", start)])
    answer = solve_laser(tmp_path / "laser.json")
    shift = ", ".join(f"{x:.5f}" for x in answer["result"]["dp_flange"])
    said = f"dp_flange = [{shift}], 95 % of errors below {answer['uncertainty']['U_point_m']:.5f} m"
    assert said in page
