"""What a run of picking says of the delays of camera and encoder."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cell.usual_delays import ARM, ARM_LATE_S, CAMERA, ENCODER_JITTER_S, ENCODER_LATE_S
from daemon.predictions import setup_of
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.contact_expectation import expected_contacts
from procedures.belt.result import BeltTrackingResult, PickingAnswer
from procedures.belt.stamp_delays import StampDelays
from procedures.belt.words import belt_tracking_lines
from tests.kit.picking_cell import JOB, picking_config

MEASURED = {"effective": 0.008, "applied": 0.0, "sigma": 0.0003}
CONFIGURED = {"effective": 0.008, "applied": 0.008}
OF_CAMERA = ("of the camera are", "0.370 mm (95 %) along the belt at the run's 0.15 m/s", "=fixed_camera`")
SLOWER = ("of the camera are", "0.270 mm (95 %) along the belt at the run's 0.15 m/s", "=fixed_camera`")
OF_ENCODER = ("of the encoder are", "0.227 mm (95 %) along the belt where", "=belt`")
BESIDE_ARM = ("of the encoder are", "0.152 mm (95 %) along the belt where", "=belt`")
BOTH = {"fixed_camera": MEASURED, "belt": MEASURED}
APART = {"fixed_camera": MEASURED, "belt": MEASURED | {"camera_sigma": 0.0}}


@pytest.mark.parametrize("encoder", [{}, {"belt": CONFIGURED}, {"belt": MEASURED | {"sigma": 0.0004}}])
def test_the_delay_of_the_camera_alone_says_how_far_all_contacts_may_be_off(
    encoder: dict[str, dict[str, float]],
) -> None:
    assert StampDelays({"fixed_camera": MEASURED, **encoder}).camera_95_s == pytest.approx(1.96 * 0.0003)
    assert StampDelays({"fixed_camera": CONFIGURED, **encoder}).camera_95_s is None
    assert StampDelays(encoder).camera_95_s is None


@pytest.mark.parametrize(
    ("offsets", "contact_m_s", "told"),
    [
        ({}, 0.15, [OF_CAMERA]),  # at an even speed nothing is to be said of the encoder
        ({}, 0.1, [SLOWER, OF_ENCODER]),
        ({"fixed_camera": MEASURED}, 0.1, [BESIDE_ARM]),
        ({"fixed_camera": CONFIGURED, "belt": MEASURED}, 0.15, [OF_CAMERA]),
        (BOTH, 0.1, []),
    ],
)
def test_a_delay_that_was_not_measured_is_named_with_its_cost_and_what_measures_it(
    offsets: dict[str, dict[str, float]], contact_m_s: float, told: list[tuple[str, str, str]]
) -> None:
    delays = StampDelays(offsets)
    delays.met(0.15, contact_m_s)
    warnings = delays.warnings()
    assert [w.code for w in warnings] == ["belt.delays"] * len(told)
    assert len(delays.assumed()) == 2 - sum(own is MEASURED for own in offsets.values())
    for warning, (device, cost, source) in zip(warnings, told, strict=True):
        assert device in warning.text
        assert cost in warning.text
        assert f"`cellward start latency-calibration -p source{source} measures it" in warning.text


def test_without_a_contact_the_cost_is_that_at_a_tenth_of_a_metre_a_second() -> None:
    camera, encoder = (warning.text for warning in StampDelays({}).warnings())
    assert "0.247 mm (95 %) along the belt at 0.10 m/s" in camera
    assert "0.454 mm (95 %) along the belt where the belt's speed changes by 0.100 m/s" in encoder


@pytest.mark.parametrize(
    "offsets",
    [{}, {"fixed_camera": MEASURED}, {"fixed_camera": CONFIGURED, "belt": MEASURED}, APART],
)
@pytest.mark.parametrize(("seen", "contact"), [(0.15, 0.15), (0.15, 0.1), (0.15, 0.0), (0.1, 0.2)])
def test_what_is_stated_is_how_late_such_devices_put_contacts(
    offsets: dict[str, dict[str, float]], seen: float, contact: float
) -> None:
    rng = np.random.default_rng(5)
    camera = CAMERA.sigma_s * rng.standard_normal(200_000)
    encoder = rng.uniform(*ENCODER_LATE_S, 200_000) + 0.5 * ENCODER_JITTER_S
    arm = rng.uniform(*ARM_LATE_S, 200_000)
    if offsets.get("fixed_camera") is MEASURED:
        camera = arm + MEASURED["sigma"] * rng.standard_normal(200_000)
    if "belt" in offsets:
        beside = camera if offsets["fixed_camera"] is CONFIGURED else arm
        encoder = beside + MEASURED["sigma"] * rng.standard_normal(200_000)
    off = camera * seen + encoder * (contact - seen) - arm * contact
    stated = StampDelays(offsets).variance(seen, contact)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(np.sqrt(stated), rel=0.01)


SPEEDS = [(0.15, 0.15), (0.15, 0.1), (0.15, 0.0), (0.1, 0.2), (-0.1, -0.2)]
CAMERA_S, OWN_S = 0.0004, 0.0003


def left_open(seen: float, contact: float, anew: bool) -> float:
    """m, root mean square: cameras are measured against arms, and encoders by their pictures; ``anew``: the
    camera once more after that."""
    rng, n = np.random.default_rng(6), 200_000
    camera, arm = CAMERA.sigma_s * rng.standard_normal(n), rng.uniform(*ARM_LATE_S, n)
    encoder = rng.uniform(*ENCODER_LATE_S, n)
    found_camera = camera - arm + CAMERA_S * rng.standard_normal(n)
    found_encoder = encoder - (camera - found_camera) + OWN_S * rng.standard_normal(n)
    if anew:
        found_camera = camera - arm + CAMERA_S * rng.standard_normal(n)
    off = (camera - found_camera) * seen + (encoder - found_encoder) * (contact - seen) - arm * contact
    return float(np.sqrt(np.mean(off**2)))


@pytest.mark.parametrize("anew", [False, True])
@pytest.mark.parametrize(("seen", "contact"), SPEEDS)
def test_the_error_of_an_encoder_has_that_of_the_camera_by_which_it_was_measured(
    seen: float, contact: float, anew: bool
) -> None:
    belt = {"sigma": float(np.hypot(CAMERA_S, OWN_S)), "camera_sigma": 0.0 if anew else CAMERA_S}
    subject = StampDelays({"fixed_camera": {"sigma": CAMERA_S}, "belt": belt})
    assert np.sqrt(subject.variance(seen, contact)) == pytest.approx(left_open(seen, contact, anew), rel=0.01)


@pytest.mark.parametrize(("seen", "contact"), SPEEDS)
def test_where_nobody_knows_which_camera_it_was_the_larger_figure_counts(seen: float, contact: float) -> None:
    belt = {"sigma": float(np.hypot(CAMERA_S, OWN_S))}
    subject = StampDelays({"fixed_camera": {"sigma": CAMERA_S}, "belt": belt})
    either = [left_open(seen, contact, anew) for anew in (False, True)]
    assert np.sqrt(subject.variance(seen, contact)) == pytest.approx(max(either), rel=0.01)


def test_a_camera_that_is_known_less_well_than_the_encoder_was_measured_anew() -> None:
    subject = StampDelays({"fixed_camera": {"sigma": 0.0005}, "belt": {"sigma": 0.0003, "camera_sigma": 0.0}})
    assert subject.variance(0.1, 0.2) == pytest.approx(0.00005**2 + 0.00003**2)


def test_check_counts_a_delay_that_was_not_measured_and_names_what_measures_it(tmp_path: Path) -> None:
    config = picking_config(tmp_path)
    setup, job = setup_of(config), BeltTrackingConfig.model_validate(config.job[JOB])
    belt = {"belt.belt": {"m_per_count_95": [0.999e-4, 1.001e-4], "dir_95_rad": 1e-3}}
    measured = {**belt, "time_offset_s.camera": {"interval95_s": [0.0, 0.0004]}}
    late, exact = (
        replace(setup, stated=lambda name, known=known: known.get(name, {})) for known in (belt, measured)
    )
    unknown, known = (expected_contacts(each, job) for each in (late, exact))
    wide, narrow = (found["contacts"][-1]["contact_parts_95_m"]["delays"] for found in (unknown, known))
    speed_m_s = unknown["contacts"][-1]["speed_m_s"]
    assert wide == pytest.approx(1.96 * speed_m_s * np.hypot(CAMERA.rms_s, ARM.rms_s), rel=0.01)
    assert narrow == pytest.approx(speed_m_s * 0.0002, rel=0.01)
    assert unknown["contacts"][-1]["contact_95_m"] > known["contacts"][-1]["contact_95_m"]
    assert len(unknown["assumed"]) == 1
    assert "camera's stamps as 0.50 ms" in unknown["text"]
    assert "`cellward start latency-calibration -p source=fixed_camera` measures" in unknown["text"]
    assert known["assumed"] == []
    assert "latency-calibration" not in known["text"]
    nominal = expected_contacts(setup, job)
    assert len(nominal["assumed"]) == 2
    # Each clause, which is shown on a line of its own, says what it is.
    clauses = nominal["text"].split("; ")
    assert len(nominal["without"]) > 1
    assert clauses[-len(nominal["without"]) :] == [f"not in it: {what}" for what in nominal["without"]]
    assert clauses[1].startswith("and by an assumption the delay of the camera's stamps")
    assert "which `cellward start belt-calibration` measures" in nominal["text"]
    assert "belt-calibration" not in unknown["text"]
    version = [{"name": "belt.belt", "state": "committed"}]
    unstated = expected_contacts(replace(setup, calibrations=lambda: version), job)
    assert "calibrated without an interval, as off by 0.5 %" in unstated["text"]
    assert "which another `cellward start belt-calibration` measures" in unstated["text"]
    assert "configured" not in unstated["text"]
    assert unstated["contacts"] == nominal["contacts"]


@pytest.mark.parametrize("known_s", [None, 0.001])
def test_what_it_may_cost_is_said_in_words(known_s: float | None) -> None:
    answer = PickingAnswer.model_construct(
        picks=3, seen=3, misses={}, success=1.0, duration_s=9.0, picks_per_minute=20.0, follow=True,
        method="ml", camera_delay_95_s=known_s, camera_95_m=known_s, contact_95_m=0.001,
        contact_95_assumed=[] if known_s else ["the delay of this and that"],
    )  # fmt: skip
    lines = belt_tracking_lines(BeltTrackingResult.model_construct(result=answer))
    words = "delay of the camera is known to 1.00 ms (95 %): all contacts may be off by 0.100 mm"
    assert len([line for line in lines if words in line]) == (known_s is not None)
    words = "in it by an assumption, as it was not measured: the delay of this and that"
    assert len([line for line in lines if words in line]) == (known_s is None)
    words = "camera's pose and lens all contacts may be off by 1.000 mm (95 %)"
    assert len([line for line in lines if words in line]) == (known_s is not None)
