"""The example package of the documents, installed by pip: it is listed, accepted, and its job runs."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from daemon.config import load_config
from daemon.config.drivers import installed_drivers
from daemon.words.result_text import result_text
from fakes.object import VirtualClock, run_virtual
from procedures import registry
from procedures.outside import installed_jobs, job_class
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report"]
EXAMPLE = Path(__file__).parents[3] / "docs/examples/acme"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("acme")
    shutil.copytree(EXAMPLE, folder / "source")  # building writes beside the sources
    how = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "install", *how, "--target", str(folder / "site")]
    subprocess.run([*pip, str(folder / "source")], check=True, capture_output=True)
    return folder / "site"


@pytest.fixture(autouse=True)
def _on_the_path(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(installed)
    name = "acme-still"
    monkeypatch.setitem(registry.JOBS, name, job_class(name, installed_jobs()[name], registry.JOBS))


def test_the_driver_and_the_job_are_found_by_their_short_names() -> None:
    assert installed_drivers()["acme-encoder"] == "acme_belt.encoder:AcmeEncoder"
    assert installed_jobs()["acme-still"] == "acme_belt.still:BeltStill"


def test_its_driver_keeps_the_contract_of_encoders(installed: Path) -> None:
    path = f"{installed}:{EXAMPLE.parents[2]}"
    command = [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", "--pyargs", "acme_belt"]
    subject = subprocess.run(command, env={"PYTHONPATH": path}, cwd=installed, capture_output=True, text=True)
    assert subject.returncode == 0, subject.stdout + subject.stderr
    assert "4 passed" in subject.stdout
    assert "this bench has no unplug" in subject.stdout


def test_a_driver_that_breaks_the_contract_fails_its_suite(installed: Path, tmp_path: Path) -> None:
    suite = (installed / "acme_belt/test_encoder.py").read_text("utf-8")
    broken = (
        "class Broken(AcmeEncoder):\n    async def wait_fresh(self, timeout):\n        pass\n\n\nclass Test"
    )
    suite = suite.replace("class Test", broken).replace("EncoderRig, AcmeEncoder", "EncoderRig, Broken")
    (tmp_path / "test_broken.py").write_text(suite, "utf-8")
    path = f"{installed}:{EXAMPLE.parents[2]}"
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", str(tmp_path)]
    subject = subprocess.run(command, env={"PYTHONPATH": path}, cwd=tmp_path, capture_output=True, text=True)
    assert subject.returncode == 1, subject.stdout + subject.stderr
    assert "2 failed" in subject.stdout
    assert "FAILED test_broken.py::TestAcmeEncoder::test_a_closed_device_says_so" in subject.stdout


def test_a_new_process_lists_both(installed: Path) -> None:
    code = "from daemon.cli.installed import list_installed as f; f(True, True, False)"
    path = f"{installed}:{EXAMPLE.parents[2]}"
    subject = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONPATH": path}, capture_output=True, text=True, check=True
    ).stdout
    assert [line.split()[-1] for line in subject.splitlines() if "acme" in line] == ["installed"] * 2


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize(("counts_per_s", "verdict"), [(0.0, "pass"), (500.0, "fail")])
def test_its_job_runs_with_its_encoder_in_the_object_twin(
    tmp_path: Path, counts_per_s: float, verdict: str
) -> None:
    config = write_config(tmp_path, "belt", jobs={"acme-still": {"seconds": 0.5}})
    path = Path(config.source)
    text = path.read_text("utf-8")
    head, _, rest = text.partition("[device.belt]")
    after = rest.partition("\n[")[2]
    device = f'[device.belt]\ndriver = "acme-encoder"\ncounts_per_s = {counts_per_s}\n'
    path.write_text(f"{head}{device}\n[{after}", "utf-8")
    subject = load_config(path)

    async def main() -> None:
        async with open_cell(subject, VirtualClock(), "acme-still") as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", verdict)
            assert abs(cell.result(run_id)["result"]["counts"] - 0.5 * counts_per_s) <= 0.02 * counts_per_s
            assert "the belt moved by" in str(result_text(cell.result(run_id)))

    run_virtual(main())
