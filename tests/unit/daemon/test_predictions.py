"""What is expected of one job, as the page shows it before anything moves."""

import pickle
from pathlib import Path
from typing import Any

import pytest

from daemon.config import CellConfig, load_config
from daemon.config.recipes import Recipe
from daemon.predictions import named, prediction_of, predictions
from procedures.laser.config import LaserReferenceConfig
from procedures.laser.plan import plan_scan
from procedures.setup import Setup
from tests.kit.object_cell import PLANNERS, write_config


@pytest.fixture
def subject(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    """A cell with crossed beams, as the process that predicts gets it."""
    monkeypatch.setattr("procedures.laser.expectation.plan_scan", PLANNERS[plan_scan])
    jobs = {"laser-reference": {"max_descents": 2, "passes": 2}, "laser-update": {"max_U_m": 1e-6}}
    write_config(tmp_path, "laser:ideal", jobs=jobs)
    loaded: CellConfig = pickle.loads(pickle.dumps(load_config(tmp_path / "cell.toml")))
    return loaded


def test_a_job_is_told_with_its_own_limits_and_what_check_tells_of_it(subject: CellConfig) -> None:
    (whole,) = (one for one in predictions(subject) if one["job"] == "laser-reference")
    found = {}
    for job in ("laser-reference", "laser-check", "laser-update"):
        expected = prediction_of(subject, job)
        assert expected is not None
        assert expected["text"] == whole["text"]
        ((found[job]),) = expected["limits"]
    # A check has the uncertainty of the reference in it, too.
    assert found["laser-check"]["value"] == pytest.approx(2**0.5 * found["laser-reference"]["value"])
    assert found["laser-update"]["limit"] == 1e-6
    assert any("[job.laser-update] max_U_m" in text for text in whole["cautions"])


def test_of_a_job_that_is_not_configured_nothing_is_told(subject: CellConfig) -> None:
    assert prediction_of(subject, "tracker-sampling") is None


def test_a_recipe_is_told_where_its_arguments_make_a_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.laser.expectation.plan_scan", PLANNERS[plan_scan])
    write_config(tmp_path, "laser:ideal", jobs={"laser-reference": {"max_descents": 2, "passes": 2}})
    path = tmp_path / "cell.toml"
    with path.open("a") as file:
        file.write('\n[recipe.often]\njob = "laser-reference"\npasses = 4\n')
        file.write('\n[recipe.same]\njob = "laser-reference"\npasses = 2\n')
    config = load_config(path)
    job, recipe = predictions(config)
    assert (job["job"], recipe["job"], recipe["recipe"]) == ("laser-reference", "laser-reference", "often")
    assert recipe["U_xy_m"] < 0.9 * job["U_xy_m"]
    assert named(recipe) == "recipe often, laser-reference"
    for name, told in (("laser-reference", job), ("often", recipe), ("same", job)):
        found = prediction_of(config, name)
        assert found is not None
        assert found["text"] == told["text"]


def test_a_recipe_of_a_check_is_told_with_its_own_tolerance_and_no_section(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.laser.expectation.plan_scan", PLANNERS[plan_scan])
    jobs = {"laser-reference": {"max_descents": 2, "passes": 2}, "laser-check": {}}
    write_config(tmp_path, "laser:ideal", jobs=jobs)
    path = tmp_path / "cell.toml"
    with path.open("a") as file:
        file.write('\n[recipe.strict]\njob = "laser-check"\ntolerance_m = 0.0002\n')
        file.write('\n[recipe.tight]\njob = "laser-update"\nmax_U_m = 1e-6\n')
    strict, tight = (one for one in predictions(load_config(path)) if "recipe" in one)
    assert (strict["job"], strict["recipe"], strict["tolerance_m"]) == ("laser-check", "strict", 0.0002)
    assert (tight["job"], [limit["limit"] for limit in tight["limits"]]) == ("laser-update", [1e-6])


def test_a_recipe_with_a_problem_of_its_own_is_told(
    subject: CellConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def expectation(setup: Setup, section: LaserReferenceConfig) -> dict[str, Any]:
        found = ["too many"] if section.passes > 5 else []
        return {"text": "no prediction before its errors are corrected", "problems": found}

    monkeypatch.setattr("procedures.laser.expectation.laser_expectation", expectation)
    recipes = {
        name: Recipe(job="laser-reference", number=None, parameters={"passes": passes})
        for name, passes in (("good", 4), ("many", 6))
    }
    told = [one for one in predictions(subject.model_copy(update={"recipe": recipes})) if "recipe" in one]
    assert [(one["recipe"], one["problems"]) for one in told] == [("many", ["too many"])]
