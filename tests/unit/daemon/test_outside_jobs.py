"""Jobs of other packages, named in ``[job.NAME] procedure``: one finding each when wrong."""

from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pydantic import BaseModel, ConfigDict

from cell.errors import InputError
from cell.procedure import Procedure, Run
from daemon.config import CellConfig, ConfigInvalid, load_config
from daemon.job_config import make_procedure
from procedures import registry
from procedures.documents import kind_of
from procedures.kind import Kind
from procedures.outside import job_class

HERE = __name__
KIND = Kind(name=f"{HERE}:KIND", words="procedures.plan_words:plan_lines")
MISNAMED = Kind(name="laser", words="")


class Step(StrEnum):
    LOOK = "look"


class JobConfig(BaseModel):
    model_config = ConfigDict(extra="forbid")
    seconds: float = 1.0


class Look(Procedure):
    name, number, kind = "acme-look", 4711, KIND.name
    Config, State = JobConfig, Step
    TRANSITIONS: ClassVar[dict[Any, Any]] = {None: frozenset({Step.LOOK})}
    CHECKPOINTS = frozenset({Step.LOOK})

    def uses(self) -> tuple[str, ...]:
        return ()

    async def run(self, run: Run) -> None: ...

    async def dry_run(self, run: Run) -> dict[str, Any]:
        return {}


class TakenNumber(Look):
    number = 1


class OtherKind(Look):
    kind = f"{HERE}:MISNAMED"


class NoKind(Look):
    kind = "acme_not_installed.job:KIND"


@pytest.fixture(autouse=True)
def _jobs_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "JOBS", dict(registry.JOBS))
    monkeypatch.setattr(registry, "CONFIGURED", {})


def load(folder: Path, section: str) -> CellConfig:
    path = folder / "cell.toml"
    path.write_text(f'schema = 1\n[cell]\nname = "x"\nstate_dir = "{folder}"\n\n{section}\n', "utf-8")
    path.chmod(0o600)
    return load_config(path)


def test_a_job_of_another_package_is_a_job_with_its_keys(tmp_path: Path) -> None:
    subject = load(tmp_path, f'[job.acme-look]\nprocedure = "{HERE}:Look"\nseconds = 2.0')
    assert registry.JOBS["acme-look"] is Look
    assert make_procedure(Look, subject, {}).config.seconds == 2.0


@pytest.mark.parametrize(
    ("name", "reference", "says"),
    [
        ("acme-look", '"acme_not_installed.job:Look"', "cannot be loaded"),
        ("acme-look", f'"{HERE}:NoSuchClass"', "cannot be loaded"),
        ("acme-look", f'"{HERE}:JobConfig"', "is no job"),
        ("acme-look", '"look"', "package.module:Class"),
        ("acme-look", "3", "should be a string"),
        ("acme-look", f'"{HERE}:TakenNumber"', "has the number 1, which is that of"),
        ("acme-look", f'"{HERE}:OtherKind"', "no Kind whose name is"),
        ("acme-look", f'"{HERE}:NoKind"', "its kind 'acme_not_installed.job:KIND' cannot be loaded"),
        ("acme-watch", f'"{HERE}:Look"', "is called 'acme-look'"),
        ("cone-capture", f'"{HERE}:Look"', "is a shipped job"),
    ],
)
def test_a_wrong_reference_is_one_finding_at_its_line(
    tmp_path: Path, name: str, reference: str, says: str
) -> None:
    with pytest.raises(ConfigInvalid) as subject:
        load(tmp_path, f"[job.{name}]\nprocedure = {reference}")
    (finding,) = subject.value.findings
    assert f"cell.toml:7: job.{name}.procedure: " in finding
    assert says in finding
    assert name not in registry.JOBS or name in registry.SHIPPED


def test_a_key_that_an_outside_job_does_not_have_is_a_finding(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match="minutes"):
        load(tmp_path, f'[job.acme-look]\nprocedure = "{HERE}:Look"\nminutes = 2.0')


def test_a_result_of_a_kind_that_is_not_installed_names_the_package() -> None:
    with pytest.raises(InputError, match="install the package 'acme_not_installed'"):
        kind_of({"kind": "acme_not_installed.job:KIND"})


def test_a_result_of_the_kind_of_a_configured_job_is_of_that_kind(tmp_path: Path) -> None:
    load(tmp_path, f'[job.acme-look]\nprocedure = "{HERE}:Look"')
    assert kind_of({"kind": KIND.name}) is KIND


def test_a_result_never_makes_us_import_what_it_names(tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "acme_trap.py").write_text("raise SystemExit('imported')\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match="install the package 'acme_trap'"):
        kind_of({"kind": "acme_trap:KIND"})


def test_a_module_that_fails_while_it_is_imported_is_told(tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "acme_broken.py").write_text("raise RuntimeError('no licence')\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(LookupError, match="no licence"):
        job_class("acme-look", "acme_broken:Look", {})
