"""Rules of the house that hold for every file."""

import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

from cell.errors import Reaction, catalogue, error
from daemon.docs.jobs import jobs_page
from procedures.registry import JOBS

ROOT = Path(__file__).parents[3]
PACKAGES = ("cell", "calibration", "procedures", "drivers", "fakes", "daemon")


def test_no_other_distribution_owns_one_of_our_folder_names() -> None:
    owners = importlib.metadata.packages_distributions()
    foreign = {p: set(owners.get(p, [])) - {"cellward"} for p in PACKAGES}
    assert not any(foreign.values()), f"import names taken by other distributions: {foreign}"


def test_every_raised_error_name_is_in_the_catalogue() -> None:
    used = {
        (path, name)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for name in re.findall(r"\berror\(\s*\"([A-Z_]+)\"", path.read_text("utf-8"))
    }
    unknown = {(str(p), n) for p, n in used if n not in catalogue()}
    assert used
    assert not unknown


def test_error_codes_are_unique_and_in_their_thousands() -> None:
    codes = [e.code for e in catalogue().values()]
    assert len(set(codes)) == len(codes)
    first = {"6": Reaction.REFUSE, "9": Reaction.INTERNAL, "4": Reaction.INPUT}
    for entry in catalogue().values():
        expected = first.get(str(entry.code)[0])
        assert expected is None or entry.reaction is expected, entry
        assert entry.hint.endswith("."), entry


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_an_error_keeps_its_class_and_detail_when_it_crosses_a_process(name: str) -> None:
    import pickle

    subject = error(name, "what was seen")
    copy = pickle.loads(pickle.dumps(subject))
    assert type(copy) is type(subject)
    assert (copy.code, str(copy)) == (subject.code, str(subject))


@pytest.mark.parametrize("job", sorted(JOBS))
def test_every_transition_table_is_sound(job: str) -> None:
    procedure = JOBS[job]
    states = set(procedure.State)
    table = procedure.TRANSITIONS
    assert states >= procedure.CHECKPOINTS
    assert set(table) == states | {None}, "every state has a row"
    reached, frontier = set(), set(table[None])
    while frontier:
        reached |= frontier
        frontier = set().union(*(table[s] for s in frontier)) - reached - {None}
    assert reached == states, f"unreachable: {states - reached}"
    ends = {s for s in states if not table[s] or None in table[s]}
    assert ends, "it has no end"


@pytest.mark.parametrize("job", sorted(JOBS))
def test_every_state_diagram_shows_an_end(job: str) -> None:
    assert "--> [*]" in jobs_page({job: JOBS[job]})


def test_whole_cells_are_where_make_test_looks_for_them() -> None:
    marked = {path for path in (ROOT / "tests").rglob("test_*.py") if "mark.alone" in path.read_text("utf-8")}
    assert {path.parent.name for path in marked - {Path(__file__)}} == {"integration"}


def test_the_package_permits_the_versions_of_python_that_make_takes() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    permitted = SpecifierSet(project["requires-python"])
    takes = [f"3.{minor}" for minor in range(8, 20) if f"3.{minor}" in permitted]
    assert takes == ["3.11", "3.12"]
    makefile = (ROOT / "Makefile").read_text("utf-8")
    (below,) = re.findall(r"version_info\[:2\] < \(3, (\d+)\)", makefile)
    (above,) = re.findall(r"version_info\[:2\] > \(3, (\d+)\)", makefile)
    assert [f"3.{minor}" for minor in range(int(below), int(above) + 1)] == takes


def test_a_python_that_lacks_what_make_asks_with_is_refused_in_a_sentence() -> None:
    (question,) = re.findall(
        r"define CHECK_PYTHON\n(.*?)endef", (ROOT / "Makefile").read_text("utf-8"), re.DOTALL
    )

    class Old:
        version_info = (2, 7, 18, "final", 0)
        exit = sys.exit

    def only_sys(name: str, *_: object) -> type:
        assert name == "sys", f"python 2 has no {name}"
        return Old

    with pytest.raises(SystemExit, match=r"on Python 3\.11 and 3\.12, not on 2\.7"):
        exec(question, {"__builtins__": {"__import__": only_sys}})


def test_nothing_tracked_names_a_registry_host_or_a_home_folder() -> None:
    # The words are put together here so that this file does not name them itself.
    forbidden = ["python" + "hosted", "pypi." + "org", "registry.npm" + "js", "/ro" + "ot/", "/wo" + "rk/"]
    hits = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in ROOT.rglob("*")
        if path.is_file()
        and path.suffix in {".py", ".toml", ".md", ".txt", ".service", ".json", ".cfg"}
        and not {".venv", ".git", "demo-out"} & set(path.relative_to(ROOT).parts)
        for word in forbidden
        if word in path.read_text("utf-8", errors="replace")
    ]
    assert not hits
