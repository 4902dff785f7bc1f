"""Faults that somebody puts into a cell: each is found by ``check`` or ends the job by its error, and no
result is wrong without a word."""

from pathlib import Path

import pytest

from tests.kit.object_cell import no_report
from tests.kit.told_faults import Claim, Row, Told, Wanted, picking
from tests.kit.told_faults_rows import ROWS

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, id=f"{row.fault}, {row.where}", marks=[pytest.mark.slow] if row.long else [])
        for row in ROWS
    ],
)
def test_a_fault_is_told_and_nothing_false_is_claimed(row: Row, tmp_path: Path) -> None:
    told = row.play(tmp_path)
    assert row.wanted.met(told), told


@pytest.mark.parametrize(
    ("told", "met"),
    [
        (Told(outcome="complete", picked=2, taken=2, claims=[Claim(0.5, 0.001)]), True),
        (Told(outcome="complete", picked=2, taken=0), False),
        (Told(outcome="complete", picked=2, taken=2, claims=[Claim(1.1)] * 3), False),
        (Told(outcome="complete", picked=4, taken=4, claims=[Claim(x) for x in (0.1, 0.2, 1.2, 0.1)]), True),
        (
            Told(outcome="complete", picked=4, taken=4, claims=[Claim(x) for x in (0.1, 0.2, 20.0, 0.1)]),
            False,
        ),
        (Told(outcome="aborted", code="GRIPS_FAILED"), False),
    ],
)
def test_a_wrong_result_without_a_word_is_not_as_wanted(told: Told, met: bool) -> None:
    assert Wanted().met(told) is met


def test_a_delay_counts_only_with_contacts_that_state_it() -> None:
    assert not Wanted(counted=True).met(Told(outcome="complete"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "late",
    [
        pytest.param({"stamp_late_s": "0.015"}, id="camera by 15 ms"),
        pytest.param({"force_walk_n": "2.0\nstamp_late_s = 0.02"}, id="arm by 20 ms"),
    ],
)
def test_a_delay_that_nothing_counts_is_not_as_wanted(late: dict[str, str], tmp_path: Path) -> None:
    told = picking(tmp_path, world=late)
    assert told.outcome == "complete"
    assert told.claims
    assert not told.true
    assert not Wanted(counted=True).met(told)


@pytest.mark.parametrize(
    ("told", "met"),
    [
        (Told(["the slider stands at 50 %"], "aborted", "ARM_SPEED_SCALED"), True),
        (Told([], "aborted", "ARM_SPEED_SCALED"), False),
        (Told(["the slider stands at 50 %"], "aborted", "INTERNAL"), False),
        (Told(["the slider stands at 50 %"], "aborted", "ARM_SPEED_SCALED", at_rest=False), False),
    ],
)
def test_the_finding_and_the_error_are_both_wanted(told: Told, met: bool) -> None:
    assert Wanted(check="slider stands", code="ARM_SPEED_SCALED").met(told) is met
