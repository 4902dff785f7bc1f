"""How far a contact may be off by all that is known, source by source."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibration.belt.estimator import BeltEstimator, EncoderScale
from calibration.belt.items import Sighting
from calibration.belt.tracking import BeltTracker, ItemTrack
from cell.run_values import RunValues
from procedures.belt.contact_uncertainty import LARGER_DELAYS, ContactBudget, Touch, shares, together
from tests.kit.contacts_stated import stated_run

V, M_PER_COUNT, PERIOD, NOW = 0.2, 1e-4, 0.005, 3.0
SEEN_S = (1.0, 1.5, 2.0)
CALIBRATED: dict[str, Any] = {
    "belt": {"m_per_count": M_PER_COUNT, "dir": [1.0, 0.0, 0.0]},
    "versions": {"belt.belt": 1},
    "uncertainty": {
        "belt.belt": {"m_per_count_95": [0.998e-4, 1.002e-4], "dir_95_rad": 1e-3},
        "T_base_camera": {"arm": {"configured": {"t": 3e-4}}},
    },
    "time_offset_s": {"fixed_camera": {"sigma": 1e-3}, "belt": {"sigma": 2e-3}},
}


def track(slower_s: float = np.inf) -> ItemTrack:
    """An item seen three times on a belt that runs evenly, or from ``slower_s`` on at half the speed."""
    tracker = BeltTracker(BeltEstimator(EncoderScale(M_PER_COUNT, None, PERIOD)), np.array([1.0, 0.0, 0.0]))

    def travel(t: float) -> float:
        return V * min(t, slower_s) + 0.5 * V * max(t - slower_s, 0.0)

    tracker.belt.extend((float(t), round(travel(t) / M_PER_COUNT)) for t in np.arange(0.0, NOW, PERIOD))
    for t in SEEN_S:
        tracker.see("1", Sighting((travel(t) - 0.6, 0.0), t, t + 0.03, True, 3e-4), 0.18)
    found = tracker.track("1")
    assert found is not None
    return found


def budget(values: dict[str, Any], camera: np.ndarray | None = None) -> ContactBudget:
    seen: Any = SimpleNamespace(left_open=lambda points: camera)
    return ContactBudget(RunValues(robot={}, **values), seen)


def touch(item: ItemTrack, t: float = NOW + 0.1, beside_m: float = 0.0) -> Touch:
    return Touch(t, item.xy(np.array([t]))[0] + [0.0, beside_m], item)


def test_each_source_counts_by_what_its_calibration_states() -> None:
    item = track()
    following, camera = np.diag([4e-8, 1e-8]), 1e-8 * np.eye(2)
    found = budget(CALIBRATED, camera).of(touch(item, beside_m=1e-4), np.zeros((3, 3)), following).parts
    way = V * (NOW + 0.1 - np.mean(SEEN_S))
    assert np.sqrt(np.diag(found["belt calibration"])) == pytest.approx(
        [1e-3 / 1.96 * 2.0 * way, 1e-3 / 1.96 * way], rel=0.01
    )
    assert np.sqrt(found["delays"][0, 0]) == pytest.approx(1e-3 * V, rel=0.02)
    assert np.diag(found["arm"]) == pytest.approx([3e-8, 3e-8])
    assert np.array_equal(found["following"], following)
    assert np.array_equal(found["camera"], camera)
    assert found["plan"][1, 1] == pytest.approx(1e-8)


def test_a_belt_whose_rise_is_hardly_known_leaves_contacts_open_by_its_level_direction_alone() -> None:
    stated = {**CALIBRATED["uncertainty"]["belt.belt"], "half_level_rad": 1e-4}
    level = budget({**CALIBRATED, "uncertainty": {"belt.belt": stated}})
    ours, older = (
        subject.of(touch(track()), np.zeros((3, 3)), None).parts["belt calibration"]
        for subject in (level, budget(CALIBRATED))
    )
    assert ours[0, 0] == older[0, 0]
    assert ours[1, 1] == pytest.approx(1e-2 * older[1, 1])


def test_a_delay_of_the_encoder_counts_by_the_change_of_the_speed() -> None:
    late = {**CALIBRATED, "time_offset_s": {"fixed_camera": {"sigma": 0.0}, "belt": {"sigma": 2e-3}}}
    even, slower = (
        budget(late).of(touch(item), np.zeros((3, 3)), None).parts["delays"][0, 0]
        for item in (track(), track(slower_s=2.3))
    )
    assert np.sqrt(even) < 1e-6
    assert np.sqrt(slower) == pytest.approx(2e-3 * 0.5 * V, rel=0.05)


def test_a_delay_that_was_not_measured_widens_what_is_stated() -> None:
    exact = {"fixed_camera": {"sigma": 0.0}, "belt": {"sigma": 0.0}}
    known, unknown = (
        budget({**CALIBRATED, "time_offset_s": offsets}).of(touch(track()), np.zeros((3, 3)), None)
        for offsets in (exact, {})
    )
    assert np.sqrt(unknown.parts["delays"][0, 0]) == pytest.approx(
        V * np.hypot(5e-4, 2e-3 / 3**0.5), rel=0.02
    )
    assert known.parts["delays"][0, 0] == 0.0
    assert unknown.r95_m > known.r95_m


def test_a_belt_that_nobody_calibrated_widens_what_is_stated() -> None:
    item = track()
    nominal = budget({**CALIBRATED, "versions": {}, "uncertainty": {}})
    way = V * (NOW + 0.1 - np.mean(SEEN_S))
    found = nominal.of(touch(item), np.zeros((3, 3)), None).parts["belt calibration"]
    assert np.sqrt(np.diag(found)) == pytest.approx([5e-3 * way, 5e-3 * way], rel=0.01)
    assert "0.5 % and the configured direction by 5 mrad" in nominal.assumed()[0]
    assert not any("direction" in told for told in budget(CALIBRATED).assumed())


def test_a_belt_that_was_calibrated_without_an_interval_is_not_called_configured() -> None:
    subject = budget({**CALIBRATED, "uncertainty": {}})
    found = subject.of(touch(track()), np.zeros((3, 3)), None).parts["belt calibration"]
    assert np.sqrt(found[0, 0] / found[1, 1]) == pytest.approx(1.0)
    assert "calibrated without an interval, as off by 0.5 % of the travel" in subject.assumed()[0]
    told = "; ".join([*subject.assumed(), *subject.not_covered()])
    assert "further from its calibrated travel" in told
    assert "configured" not in told


def test_the_whole_is_larger_than_any_part_and_shares_add_up() -> None:
    of = budget(CALIBRATED, 1e-8 * np.eye(2)).of
    near, far = (of(touch(track(), NOW + ahead), np.zeros((3, 3)), 1e-8 * np.eye(2)) for ahead in (0.1, 0.6))
    parts = near.as_dict()["contact_parts_95_m"]
    assert isinstance(parts, dict)
    assert near.r95_m > max(parts.values())
    assert far.r95_m > near.r95_m
    whole = together([near, far])
    assert whole is not None
    assert near.r95_m < whole.r95_m < far.r95_m
    assert sum(shares(whole).values()) == pytest.approx(1.0)
    assert together([]) is None


def test_what_was_not_measured_is_named() -> None:
    unknown = budget({"belt": CALIBRATED["belt"]})
    parts = unknown.of(touch(track()), np.zeros((3, 3)), None).parts
    assert set(parts) == {"sightings", "belt motion", "plan", "belt calibration", "delays"}
    told = "; ".join(unknown.not_covered())
    for word in (
        "arm's own accuracy",
        "pose and lens",
        "further from its configured travel and direction",
        "row_time_s",
        "gripper",
    ):
        assert word in told, word
    known = budget(CALIBRATED, 1e-8 * np.eye(2))
    known.of(touch(track()), np.zeros((3, 3)), 1e-8 * np.eye(2))
    assert "measured" not in "; ".join(known.not_covered())
    assert "gripper" in known.not_covered()[0]


def test_contacts_of_a_camera_that_exposes_by_itself_are_within_what_their_records_state(
    tmp_path: Path,
) -> None:
    dim = {"exposure_s": "0.004\nauto_exposure = { light_lux = 100.0 }", "spacing_m": "0.25"}
    run = stated_run(tmp_path, 3, dim, {"dwell_s": 0.05}, 11.0)
    assert run.outcome == "complete"
    assert len(run.contacts) >= 3
    assert sum(contact.inside for contact in run.contacts) >= len(run.contacts) - 1
    answer = run.answer
    assert answer["contact_95_m"] > 2.0 * answer["camera_95_m"]
    assert max(contact.r95_m for contact in run.contacts) < 1.5e-3
    assert answer["contact_95_shares"]["sightings"] > 0.3
    assert "the arm's own accuracy, which was not measured" in answer["contact_95_without"]


def test_contacts_of_a_cell_without_measured_delays_are_within_what_their_records_state(
    tmp_path: Path,
) -> None:
    run = stated_run(tmp_path, 2, {"spacing_m": "0.25"}, {"dwell_s": 0.05}, 11.0, measured=False)
    assert run.outcome == "complete"
    assert len(run.contacts) >= 3
    assert sum(contact.inside for contact in run.contacts) >= len(run.contacts) - 1
    answer = run.answer
    assert answer["camera_delay_95_s"] is None
    assert answer["contact_95_shares"]["delays"] > 0.1
    assert [text.split(" stamps")[0] for text in answer["contact_95_assumed"]] == [
        "the delay of the camera's",
        "the delay of the encoder's",
    ]
    assert [text for text in answer["contact_95_without"] if "delay" in text] == [LARGER_DELAYS]
