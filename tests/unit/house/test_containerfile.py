"""The images for training and for CI: judged without a container engine."""

import re
import subprocess
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

from fakes.twin.control import default_folder

ROOT = Path(__file__).parents[3]
INSTRUCTIONS = {"ARG", "FROM", "RUN", "COPY", "ENV", "USER", "WORKDIR", "CMD"}
INSTALL = ROOT / ".ci/install"
Steps = list[tuple[str, str]]


@pytest.fixture
def subject() -> dict[str, Steps]:
    """The instructions of each stage, in their order; those before the first FROM belong to ''."""
    text = (ROOT / "deploy/Containerfile").read_text("utf-8")
    text = re.sub(r"(?m)^#.*\n", "", text).replace("\\\n", " ")
    stages: dict[str, Steps] = {"": []}
    for line in filter(None, map(str.strip, text.splitlines())):
        instruction, _, words = line.partition(" ")
        assert instruction in INSTRUCTIONS, line
        if instruction == "FROM":
            base, name = re.fullmatch(r"(\S+) AS ([a-z]+)", words).groups()  # type: ignore[union-attr]
            assert base == "${BASE}" or base in stages, f"{line}: a stage begins from Debian or one before it"
            stages[name] = [*stages[base]] if base in stages else []
        else:
            stages[list(stages)[-1]].append((instruction, " ".join(words.split())))
    return stages


def said(steps: Steps, instruction: str) -> list[str]:
    return [words for named, words in steps if named == instruction]


def test_the_images_are_of_debian_12_and_the_twin_is_what_is_built_unless_told(
    subject: dict[str, Steps],
) -> None:
    assert subject[""] == [("ARG", "BASE=docker.io/library/debian:bookworm-slim")]
    assert "ci" in subject
    assert list(subject)[-1] == "twin"


def test_what_is_copied_is_in_the_checkout_and_what_the_program_is_made_of_is_not_ignored(
    subject: dict[str, Steps],
) -> None:
    made = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    include = [name.rstrip("*") for name in made["tool"]["setuptools"]["packages"]["find"]["include"]]
    data = [path for paths in made["tool"]["setuptools"]["data-files"].values() for path in paths]
    needed = {"pyproject.toml", "constraints.txt", made["project"]["readme"], *include}
    needed |= {path.partition("/")[0] for path in data}
    for words in {words for steps in subject.values() for words in said(steps, "COPY")}:
        source = words.split()[0]
        if source.startswith("--from="):
            assert source.removeprefix("--from=") in subject
        else:
            assert (ROOT / source).exists(), words
            needed.add(source.partition("/")[0])
    needed.discard(".")
    ignored = set()
    for rule in (ROOT / ".dockerignore").read_text("utf-8").splitlines()[1:]:
        named = {name for name in needed if fnmatch(name, rule.removeprefix("!"))}
        ignored = ignored - named if rule.startswith("!") else ignored | named
    assert not ignored


def test_the_twin_is_no_root_and_brings_no_compiler(
    subject: dict[str, Steps], monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = subject["twin"]
    for words in said(steps, "RUN"):
        assert not re.search(r"\b(gcc|g\+\+|build-essential|clang|make|pip|\S+-dev)\b", words), words
    ((uid, user),) = re.findall(r"useradd --create-home --uid (\d+) (\w+)", " ".join(said(steps, "RUN")))
    assert said(steps, "USER") == [user]
    assert "RUN" not in dict(steps[steps.index(("USER", user)) :])
    variables = dict(pair.split("=") for pair in " ".join(said(steps, "ENV")).split())
    monkeypatch.setattr("os.getuid", lambda: int(uid))
    monkeypatch.setattr("tempfile.gettempdir", lambda: variables["TMPDIR"])
    assert variables["CELLWARD_CONFIG"] == str(default_folder() / "cell.toml")


def test_ci_and_its_image_install_from_one_list(subject: dict[str, Steps]) -> None:
    run = (ROOT / ".ci/run").read_text("utf-8")
    assert ".ci/install ||" in run
    assert "install -y" not in run
    (copied,) = said(subject["ci"], "COPY")
    assert copied.split()[0] == ".ci/install"
    assert INSTALL.stat().st_mode & 0o111
    (command,) = said(subject["ci"], "RUN")
    assert command.split(" && ")[0] == Path(copied.split()[1]).name
    assert "apt-get install" not in command


def test_every_program_that_a_test_is_skipped_without_is_on_the_list() -> None:
    listed = INSTALL.read_text("utf-8").partition("<<'END'\n")[2].partition("\nEND")[0].split()
    wanted = set()
    for path in (ROOT / "tests").rglob("test_*.py"):
        wanted |= set(re.findall(r"""(?:which|needs)\(f?"([a-z-]+)"\)""", path.read_text("utf-8")))
    assert {"mbpoll", "openssl"} <= wanted
    assert {name for name in wanted if name not in listed and name.partition("-")[0] not in listed} == set()


def test_make_image_builds_what_it_is_told_and_says_what_it_lacks(subject: dict[str, Steps]) -> None:
    def make(*words: str) -> subprocess.CompletedProcess[str]:
        command = ["make", "--no-print-directory", "image", *words]
        bare = {"PATH": "/usr/local/bin:/usr/bin:/bin"}  # not the flags of a make that runs the tests
        return subprocess.run(
            command, cwd=ROOT, env=bare, capture_output=True, text=True, timeout=60, check=False
        )

    told = make("--dry-run", "ENGINE=podman", "IMAGE=ci").stdout.splitlines()[-1]
    words = "podman build --file deploy/Containerfile --target ci --tag cellward-ci ."
    assert " ".join(told.split()) == words
    lacking = make("ENGINE=")
    assert lacking.returncode != 0
    assert lacking.stderr.startswith("make image needs podman, buildah or docker")
