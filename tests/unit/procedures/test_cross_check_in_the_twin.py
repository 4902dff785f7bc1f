"""The bench of the cross check in the twin: faults of the world reach the verdict, and the table counts."""

from dataclasses import replace
from pathlib import Path

import pytest

import bench.cross_check as bench
from bench import _cross_twin as subject
from bench._cross_twin import Fault, Told

FEW = (
    ("poses_per_placement = 40", "poses_per_placement = 16"),
    ("frames_per_pose = 5", "frames_per_pose = 3"),
    ("passes = 3", "passes = 1"),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "touch", "named"),
    [
        ([Fault("tool", 2e-3), Fault("joint", 4e-3)], False, ["tool", "zero of wrist 2"]),
        ([Fault("camera", 8e-3)], True, ["camera"]),
    ],
)
def test_each_fault_of_the_twin_is_named(
    faults: list[Fault], touch: bool, named: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = subject.cell_text

    def hasty() -> str:
        text = shipped()
        for old, new in FEW:
            assert old in text
            text = text.replace(old, new)
        return text

    monkeypatch.setattr(subject, "cell_text", hasty)
    told = subject.played(3, faults, touch)
    assert [one.named for one in told] == named, told
    assert all(one.good and one.sized for one in told)
    assert not any(one.wrong for one in told)


def told(fault: str, right: str, named: str, seed: int = 1, sized: bool | None = None) -> Told:
    probable = {"none": 0.6, "tool": 0.4, "several": 1e-9}
    return Told(seed, fault, right, named, sized, probable, 2.0, "no beams" if named == "not done" else "")


def test_the_table_tells_a_wrong_part_from_one_that_could_not_be_told() -> None:
    rows = bench.twin_table(
        [
            told("tool 0.7", "tool", "tool", 1, True),
            told("tool 0.7", "tool", "tool", 2, False),
            told("tool 0.7", "tool", "none", 3),
            told("tool 0.7", "tool", "cannot-tell", 4),
            told("tool 0.7", "tool", "not done", 5),
            told("joint 1", "zero of elbow", "zero of wrist 1", 6),
        ],
        ["tool 0.7", "joint 1"],
    )
    assert rows[1].split() == ["tool", "0.7", "5", "2", "1", "1", "1", "1", "of", "2", "2.0"]
    assert rows[2].split() == ["joint", "1", "1", "0", "0", "1", "0", "-", "2.0"]
    assert [row.strip() for row in rows[3:]] == [
        "cell 3, tool 0.7: none, not tool; none 60.0 %, tool 40.0 %",
        "cell 4, tool 0.7: cannot-tell, not tool; none 60.0 %, tool 40.0 %",
        "cell 5, tool 0.7: not done, not tool; no beams",
        "cell 6, joint 1: zero of wrist 1, not zero of elbow; none 60.0 %, tool 40.0 %",
    ]


@pytest.mark.parametrize(
    ("named", "code"),
    [(None, 0), ("cannot-tell", 1), ("none", 1)],
)
def test_a_bench_that_was_ended_goes_on_and_is_good_where_enough_are_named(
    named: str | None, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[tuple[int, list[str]]] = []

    def play(seed: int, faults: list[Fault], touch: bool) -> list[Told]:
        ran.append((seed, [fault.name for fault in faults]))
        return [told(f.name, f.part, (named if seed == 2 else None) or f.part, seed) for f in faults]

    monkeypatch.setattr(bench, "played", play)
    keep = tmp_path / "kept.jsonl"
    keep.write_text(told("none", "none", "none", 1).as_json() + "\n", "utf-8")
    assert bench.in_twin(range(1, 3), None, keep) == code
    every = ["none", "tool 0.7", "camera 1", "joint 1"]
    assert ran == [(1, every[1:]), (2, every)]
    assert bench.in_twin(range(1, 3), None, keep) == code
    assert len(ran) == 2, "a cell was played again"


def test_faults_by_the_beams_and_by_a_touch_test_are_kept_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[tuple[list[str], bool]] = []

    def play(seed: int, faults: list[Fault], touch: bool) -> list[Told]:
        ran.append(([fault.name for fault in faults], touch))
        return [replace(told(f.name, f.part, f.part, seed), touch=touch) for f in faults]

    monkeypatch.setattr(bench, "played", play)
    keep = tmp_path / "kept.jsonl"
    for _ in range(2):
        for touch in (False, True):
            assert bench.in_twin(range(1, 2), None, keep, touch) == 0
    every = ["none", "tool 0.7", "camera 1", "joint 1"]
    assert ran == [(every, False), (["none", "tool 1.5", *every[2:]], True)]
