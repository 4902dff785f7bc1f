"""Whether a check says that the tool has moved: by the odds that it states, in words, and with what to do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.run_values import RunValues
from daemon.words.result_text import result_text
from fakes.object import run_virtual
from procedures.laser.check import known_of
from procedures.laser.config import LaserCheckConfig
from procedures.laser.judging import judge_check, judge_moved
from procedures.laser.moved import FALSE_ALARM, FLOOR_M, by_chance, tolerance, whether_moved
from procedures.laser.result import Apart
from tests.kit.laser_cell import laser_cell, laser_config, states_of_results
from tests.kit.laser_made import T_TOOL, Solved, drawn_reference, solved
from tests.kit.laser_runs import replayed
from tests.kit.object_cell import no_report

__all__ = ["no_report", "solved"]

BUMP = [0.0012, -0.0007, 0.0005]  # 1.48 mm: within the limits of a bent tool
SIGMA_M, SIGMA_RAD = 0.0000129, 0.0006  # U of 0.036 mm
COV = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 2 + [0.0])
CONFIG = LaserCheckConfig().model_dump()
NO_SHIFT = Apart(shift_m=[0.0] * 3, shift=0.0, tilt_rad=0.0)
KNOWN = {"T_flange_tool_ref": T_TOOL, "T_flange_tool_last": T_TOOL, "offset_s": 0.0}


def judged(
    dp: list[float], drot: list[float] | None = None, known: dict[str, Any] = KNOWN, **config: Any
) -> dict[str, Any]:
    """The document of a check that measured ``dp`` and ``drot`` against the reference."""
    measured = Solved(dp=dp, drot=drot, U=0.000036).current()
    measured = measured.changed(result=measured.result.changed(cov=COV.tolist()))
    config = {**CONFIG, **config}
    return judge_moved(judge_check(measured, known, config), known, config).as_json()


def test_a_tool_bumped_by_a_millimetre_and_a_half_fails_and_names_the_next_command() -> None:
    subject = judged(BUMP)
    assert subject["verdict"] == "fail"
    assert subject["reasons"] == [
        "tool moved: the tool's point has moved by 1.48 mm (uncertainty 0.036 mm, tolerance 0.10 mm): "
        "run laser-update"
    ]
    assert subject["result"]["moved"]["moved"] is True


def test_a_tool_that_has_not_moved_passes_and_the_test_is_shown() -> None:
    subject = judged([0.00002, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert (subject["verdict"], subject["reasons"]) == ("pass", [])
    text = result_text(subject)
    assert "the tool has not moved against the tool frame in effect: point 0.02 mm (uncertainty" in text
    assert "axis 0.00 deg (uncertainty 0.08 deg, tolerance 0.12 deg)" in text
    assert "a tool that has not moved is called moved in 1 of 300 checks at most, one that moved by" in text


def test_an_axis_that_turned_has_moved_too() -> None:
    subject = judged([0.0, 0.0, 0.0], [0.006, 0.0, 0.0])
    assert subject["reasons"][0].startswith("tool moved: the tool's axis has turned by 0.34 deg")
    assert "run laser-update" in subject["reasons"][0]


def test_a_bent_tool_keeps_its_own_words() -> None:
    subject = judged([0.004, 0.0, 0.0])
    assert subject["verdict"] == "fail"
    assert all(reason.startswith("bent tool") for reason in subject["reasons"])
    assert subject["result"]["moved"]["moved"] is True


def test_a_tool_that_was_corrected_since_the_reference_is_judged_by_its_frame_in_effect() -> None:
    corrected = [t + d for t, d in zip(T_TOOL, BUMP, strict=False)] + T_TOOL[3:]
    subject = judged(BUMP, known={**KNOWN, "T_flange_tool_last": corrected})
    assert subject["verdict"] == "pass"
    assert subject["result"]["moved"]["U_shift_m"] == pytest.approx(np.sqrt(2.0) * 0.000036, rel=0.02)


def test_a_configured_tolerance_replaces_the_usual_one() -> None:
    assert judged([0.0005, 0.0, 0.0], tolerance_m=0.001)["verdict"] == "pass"
    assert judged([0.00007, 0.0, 0.0], tolerance_m=0.00006)["verdict"] == "fail"
    assert judged([0.00007, 0.0, 0.0])["verdict"] == "pass"
    assert judged([0.0, 0.0, 0.0], [0.003, 0.0, 0.0], tolerance_rad=0.004)["verdict"] == "pass"


def test_a_tolerance_below_the_uncertainty_is_what_chance_exceeds_as_seldom_as_is_stated() -> None:
    tight = {"tolerance_m": 1e-5, "tolerance_rad": 1e-5}
    test = judged([0.00004, 0.0, 0.0], [0.001, 0.0, 0.0], **tight)["result"]["moved"]
    assert not test["moved"]
    assert test["tolerance_m"] == by_chance(COV[:3, :3])
    assert test["tolerance_rad"] == by_chance(COV[3:, 3:])
    assert test["detectable_m"] > test["tolerance_m"]


@pytest.mark.parametrize(("key", "value"), [("tolerance_m", 0.0025), ("tolerance_rad", 0.025)])
def test_a_tolerance_above_the_limit_of_a_bent_tool_is_refused(key: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{key}, .* is above against_last.max_"):
        LaserCheckConfig.model_validate({key: value})


@pytest.mark.parametrize("config", [CONFIG, {**CONFIG, "tolerance_m": 2e-5, "tolerance_rad": 1e-4}])
@pytest.mark.parametrize("same", [True, False])
def test_a_good_tool_is_called_moved_in_at_most_one_of_three_hundred_checks(
    same: bool, config: dict[str, Any]
) -> None:
    cov = 100.0 * COV  # far above the floors
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(6), cov if same else 2.0 * cov, 60_000)
    shifts, turns = (np.linalg.norm(part, axis=1) for part in (draws[:, :3], draws[:, 3:]))
    test = whether_moved(NO_SHIFT, cov, config, same, tilted=True)
    share = np.mean((shifts > test.tolerance_m) | (turns > test.tolerance_rad))
    assert 0.5 * FALSE_ALARM < share < 1.15 * FALSE_ALARM  # 200 expected, standard deviation 14


def test_the_chance_of_a_false_alarm_is_a_key_and_sets_what_is_found() -> None:
    cov, none = 100.0 * COV, NO_SHIFT
    often = whether_moved(none, cov, {**CONFIG, "false_alarm": 0.05}, True, tilted=True)
    seldom = whether_moved(none, cov, CONFIG, True, tilted=True)
    assert often.tolerance_m < seldom.tolerance_m
    draws = np.random.default_rng(5).multivariate_normal(np.zeros(3), cov[:3, :3], 30_000)
    for test in (often, seldom):
        moved = np.linalg.norm(draws + np.array([0.0, test.detectable_m, 0.0]), axis=1) > test.tolerance_m
        assert np.mean(moved) >= 0.99


@pytest.mark.parametrize("found", [{"shift": np.nan, "tilt_rad": 0.0}, {"shift": 0.0, "tilt_rad": np.inf}])
def test_a_difference_that_is_no_number_is_refused_and_not_called_unmoved(found: dict[str, float]) -> None:
    with pytest.raises(CellError, match="not a finite number") as caught:
        whether_moved(NO_SHIFT.changed(**found), COV, CONFIG, True, tilted=True)
    assert caught.value.name == "SOLVE_REFUSED"


@pytest.mark.parametrize("hole", [(0, 1), (2, 2), (4, 4)])
def test_a_covariance_that_is_no_number_is_refused_and_not_called_unmoved(hole: tuple[int, int]) -> None:
    cov = COV.copy()
    cov[hole] = np.nan
    with pytest.raises(CellError, match="not a finite number") as caught:
        whether_moved(NO_SHIFT, cov, CONFIG, True, tilted=True)
    assert caught.value.name == "SOLVE_REFUSED"


def test_a_better_measurement_than_the_floor_does_not_call_repeatability_a_move() -> None:
    assert tolerance(np.diag([1e-14] * 3), FLOOR_M) == FLOOR_M


def test_a_run_that_was_made_without_a_test_replays_without_one() -> None:
    config = {k: v for k, v in CONFIG.items() if not k.startswith("tolerance")}
    document = judge_check(Solved(dp=BUMP).current(), KNOWN, config)
    assert judge_moved(document, KNOWN, config) == document


@pytest.mark.usefixtures("no_report")
def test_the_job_itself_fails_for_a_tool_that_moved_and_replays_so(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)
    solved.dp = BUMP

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert cell.engine.last is not None
            assert cell.engine.last["result"]["reasons"][0].startswith("tool moved: ")
            assert cell.notes(1, "tool moved")
            assert states_of_results(cell) == [], "a check proposes nothing"
            assert replayed(cell, 1) == []
            assert set(known_of(RunValues.of(cell.folder(1).info["values"]))) == set(KNOWN)

    run_virtual(main())
