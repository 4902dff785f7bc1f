"""Limits on the unweighted spreads of a capture, and the two of two runs beside each other."""

import json

import numpy as np
import pytest

from calibration.hand_eye.neighbours import NeighbourEstimates
from calibration.odds import FALSE_ALARM
from cell.errors import InputError
from procedures.hand_eye.comparison import compare_hand_eye
from procedures.hand_eye.config import Acceptance
from procedures.hand_eye.report.checks import consistency_section
from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.result import HandEyeResult
from procedures.hand_eye.result_spread import NeighbourBase, PlainSpread
from procedures.hand_eye.solve.neighbours import Neighbours
from procedures.hand_eye.solve.solver import solve_hand_eye
from procedures.hand_eye.verdict import judged
from procedures.hand_eye.words import spread_lines
from tests.kit.contradictions import good

WIDE = {"max_error_t_m": 0.1, "max_error_r_rad": 0.1}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> HandEyeResult:
    path = tmp_path_factory.mktemp("capture") / "capture.json"
    path.write_text(json.dumps(good(np.random.default_rng(3), joints=True, plan="few")), "utf-8")
    result = solve_hand_eye(path, calls=1)
    assert isinstance(result, HandEyeResult)
    return result


def spread_within(of: HandEyeResult) -> float:
    assert of.result.neighbour_spread is not None
    assert of.result.neighbour_spread.within is not None
    return of.result.neighbour_spread.within.t_norm


def test_a_spread_beyond_its_limit_fails_the_result_and_names_the_limit(found: HandEyeResult) -> None:
    limit = 0.5 * spread_within(found)
    subject = judged(found, Acceptance(**WIDE, max_spread_within_t_m=limit))
    assert isinstance(subject, HandEyeResult)
    assert subject.verdict == "fail"
    assert subject.reasons[0].startswith("max_spread_within_t_m: unweighted spread within placements")
    assert "the unweighted spreads are not within their limits" in " ".join(spread_lines(subject.result))


def test_spreads_within_their_limits_are_said_to_be(found: HandEyeResult) -> None:
    limit = 2.0 * spread_within(found)
    subject = judged(found, Acceptance(**WIDE, max_spread_within_t_m=limit))
    assert isinstance(subject, HandEyeResult)
    assert subject.verdict == found.verdict
    assert "the unweighted spreads are within their limits: within" in " ".join(spread_lines(subject.result))


def test_without_limits_nothing_is_judged_and_the_result_is_as_before(found: HandEyeResult) -> None:
    subject = judged(found, Acceptance(**WIDE))
    assert isinstance(subject, HandEyeResult)
    assert subject.result.neighbour_spread == found.result.neighbour_spread


def test_a_spread_that_cannot_be_computed_is_within_no_limit(found: HandEyeResult) -> None:
    bare = found.changed(result=found.result.changed(neighbour_spread=None))
    subject = judged(bare, Acceptance(**WIDE, max_spread_across_r_rad=0.1))
    assert subject.verdict == "fail"
    assert "too few poses or placements for a spread across placements" in subject.reasons[0]


def test_estimates_that_lie_metres_apart_give_no_spread_and_no_pose_but_the_reason(
    found: HandEyeResult,
) -> None:
    at = np.tile(np.eye(4), (2, 4, 1, 1))  # two placements of four estimates
    at[:, 0, 0, 3] = 3.0
    apart = [NeighbourEstimates(g, X, np.zeros((4, 3), dtype=np.int64), 0, X[1]) for g, X in enumerate(at)]
    subject = Neighbours(apart, np.array([-1, -1]), planned=True)
    spread = subject.spread()
    assert (spread.within, spread.pose) == (None, None)
    assert spread.across is not None, "the means agree"
    result = found.changed(result=found.result.changed(neighbour_spread=spread))
    told = "not determined: the estimates lie more than 1 m apart"
    assert told in spread_lines(result.result)[-1]
    beyond = judged(result, Acceptance(**WIDE, max_spread_within_t_m=0.1))
    assert beyond.reasons[0].startswith("max_spread_within_t_m: the estimates lie more than 1 m apart")
    with pytest.raises(InputError, match="'classic': the estimates lie more than 1 m apart"):
        subject.pose("classic")
    np.testing.assert_allclose(subject.pose("classic-least-squares"), np.eye(4), atol=1e-12)


def test_a_comparison_shows_the_spreads_of_both(found: HandEyeResult) -> None:
    subject = compare_hand_eye(found, found, FALSE_ALARM)
    text = subject.text("run 1", "run 2")
    assert "run 1: spread within placements" in text
    assert "run 2: unweighted, from neighbours" in text
    first, second = subject.as_dict()["spreads"]
    assert first == second
    assert first["neighbour_spread"]["within"]["t_norm"] == spread_within(found)


def test_the_unweighted_spreads_are_shown_for_all_and_for_each_place_of_the_stand(
    found: HandEyeResult,
) -> None:
    classic = found.result.neighbour_spread
    assert classic is not None
    assert classic.within is not None
    wider = PlainSpread(t=[0.004] * 3, t_norm=0.007, r=0.001)
    bases = {
        "0": NeighbourBase(within=classic.within, across=None),
        "1": NeighbourBase(within=wider, across=wider),
    }
    answer = found.result.changed(neighbour_spread=classic.changed(by_base=bases))
    lines = spread_lines(answer)
    assert "unweighted, base 2: within placements 7.000 mm, 0.0573 deg; across" in "\n".join(lines)
    page = consistency_section(HandEyeSource(found.changed(result=answer)))
    assert page is not None
    for told in ("all placements", "base 1", f"{1e3 * classic.within.t_norm:.3f} mm", "base 2", "7.000 mm"):
        assert told in page
