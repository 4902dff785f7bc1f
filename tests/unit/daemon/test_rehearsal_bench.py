"""The bench of rehearsals: its table is made of all twins that were kept, over several sittings."""

from pathlib import Path

import pytest

import bench.rehearsal as subject
from daemon.config import CellConfig
from daemon.rehearsal.play import RehearsedRun


def played(job: str, seed: int) -> subject.Played:
    """Outside in every fourth twin."""
    turn = 0.5 if seed % 4 else 1.25
    outcome = RehearsedRun(
        seed, "complete", 60.0, "pass", "1 mm", "2 mm", True, turn < 1.0, {"shift": 0.5, "turn": turn}
    )
    return subject.Played(job, outcome, 2.0, 61.0 if seed == 8 else 3.0)


def test_a_bench_goes_on_where_it_was_and_tells_which_error_was_outside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[tuple[str, int]] = []

    def play(job: str, seed: int) -> subject.Played:
        if seed == 4 and len(ran) < 4:
            raise KeyboardInterrupt
        ran.append((job, seed))
        return played(job, seed)

    monkeypatch.setattr(subject, "_play", play)
    words = ["2", "cone-capture", "laser-check", "--first", "3", "--keep", str(tmp_path / "kept.jsonl")]
    with pytest.raises(KeyboardInterrupt):
        subject.main(words)
    ran += [("", 0)] * 2  # now the others run too
    subject.main(words)
    assert [one for one in ran if one[0]] == [
        ("cone-capture", 3),
        ("laser-check", 3),
        ("cone-capture", 4),
        ("laser-check", 4),
    ]
    capsys.readouterr()
    subject.main(["1", "cone-capture", "--first", "8", "--keep", str(tmp_path / "kept.jsonl")])
    told = capsys.readouterr().out.splitlines()
    assert told[1].split() == [
        "cone-capture",
        "3",
        "3",
        "1/3",
        "(0.8",
        "to",
        "90.6",
        "%)",
        "60",
        "2.0",
        "61.0",
    ]
    assert told[2] == "    twin 8: MORE THAN A MINUTE, 61 s"
    assert told[3:] == [
        f"    twin {seed}: outside; of the 95 % limits: shift 0.50, turn 1.25" for seed in (4, 8)
    ]


def test_the_delay_of_an_encoder_is_a_row_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def rehearse(config: CellConfig, path: Path, job: str, *_: object) -> RehearsedRun:
        asked.append((job, config.job["latency-calibration"]["source"]))
        return RehearsedRun(1, "complete", 60.0)

    monkeypatch.setattr(subject, "rehearse", rehearse)
    assert "latency-calibration/belt" in subject.JOBS
    assert subject._play("latency-calibration/belt", 1).job == "latency-calibration/belt"
    assert asked == [("latency-calibration", "belt")]


def test_what_is_kept_is_read_as_it_was_also_with_figures_that_are_no_more(tmp_path: Path) -> None:
    line = played("x", 4).as_json()
    assert subject.Played.from_json(line) == played("x", 4)
    assert subject.Played.from_json(line.replace('"seed"', '"gone": 1, "seed"')) == played("x", 4)
    earlier = subject.Played.from_json(line.replace(', "wall_s": 3.0', ""))
    assert earlier.wall_s is None
    assert next(subject.lines_of([earlier])).endswith(" -")


def test_errors_stand_beside_their_limits_in_units_for_people() -> None:
    limits = {"shift": (0.002, "m"), "scale": (0.001, "1")}
    outcomes = [
        RehearsedRun(
            seed, "complete", 60.0, "pass", "", "", True, True, {"shift": shift, "scale": 0.3}, limits
        )
        for seed, shift in ((1, 1.25), (2, 0.75))
    ]
    assert list(subject.lines_of([subject.Played("x", outcome, 2.0) for outcome in outcomes]))[1:] == [
        "    shift: 2.0616 mm off (RMS), 2.0000 mm stated (95 %, RMS), 1/2 inside",
        "    scale: 0.0300 % off (RMS), 0.1000 % stated (95 %, RMS), 2/2 inside",
    ]


@pytest.mark.parametrize(
    ("inside", "of", "low", "high"),
    # Tables of the binomial distribution: 1 - 0.025^(1/n) of none, and 90 of 100.
    [(0, 10, 0.0, 0.3085), (10, 10, 0.6915, 1.0), (90, 100, 0.8238, 0.9510)],
)
def test_the_interval_of_a_share_is_exact(inside: int, of: int, low: float, high: float) -> None:
    assert subject.exact_interval(inside, of) == pytest.approx((low, high), abs=1e-4)
