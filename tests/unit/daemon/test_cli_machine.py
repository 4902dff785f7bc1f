"""``cellward check --machine``: figures of this machine, judged by stated limits."""

import re
from pathlib import Path

import pytest

from daemon.cli import machine as subject


def found(name: str, folder: Path) -> dict[str, object]:
    return next(one for one in subject.machine(folder) if one["name"] == name)


def test_every_figure_has_a_verdict_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subject, "PROBE_S", 0.05)
    figures = subject.machine(tmp_path / "not" / "yet" / "made")
    names = [one["name"] for one in figures]
    assert {"cores", "real time", "loop lag", "thread lag", "free space", "fsync", "kernel"} <= set(names)
    assert all(one["text"] for one in figures)
    assert list(tmp_path.iterdir()) == [], "nothing is left behind"


@pytest.mark.parametrize(
    ("longest", "good", "words"),
    [(0.002, True, "good"), (0.05, False, "taken again"), (0.3, False, "interrupted")],
)
def test_a_lag_is_judged_by_what_it_does_to_a_job(longest: float, good: bool, words: str) -> None:
    one = subject._lag("loop", "the event loop", [0.0001, longest])
    assert (one.value, one.good) == (longest, good)
    assert words in one.text


def test_a_machine_with_few_cores_or_a_slow_disk_is_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subject, "PROBE_S", 0.02)
    monkeypatch.setattr(subject.os, "sched_getaffinity", lambda _: {0})
    monkeypatch.setattr(subject, "_fsync", lambda folder: 0.4)
    assert found("cores", tmp_path)["good"] is False
    slow = found("fsync", tmp_path)
    assert (slow["value"], slow["good"]) == (0.4, False)


def test_a_system_that_refuses_real_time_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(subject.os, "sched_setscheduler", refuse)
    one = subject._priorities()
    assert (one.good, one.value) == (False, 0.0)
    assert "not permitted" in one.text


def test_a_folder_that_cannot_be_written_is_said_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(folder: Path) -> float:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(subject, "_fsync", refuse)
    _, fsync = subject._disk(tmp_path)
    assert (fsync.value, fsync.good) == (None, False)
    assert "Permission denied" in fsync.text


def test_the_manual_has_each_figure_and_the_limits_of_the_program(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "cell-pc.md").read_text("utf-8")
    for name in ("cores", "real time", "loop lag", "thread lag", "free space", "fsync", "governor", "kernel"):
        assert f"`{name}`" in page
    assert f"{subject.MIN_CORES} or more" in page
    assert f"{subject.MIN_FREE_BYTES / 1e9:.0f} GB" in page
    assert f"{1e3 * subject.FSYNC_S:.0f} ms" in page
    assert re.search(rf"below {1e3 * subject.LAG_SOFT_S:.0f} ms; above {1e3 * subject.LAG_S:.0f} ms", page)
