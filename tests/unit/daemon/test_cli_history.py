"""Commands that read run folders and the ledger, and need no daemon."""

import hashlib
import json
import os
import subprocess
import sys
from html import escape
from pathlib import Path
from typing import Any

import pytest

from cell.errors import error
from cell.store.ledger import Ledger
from cell.store.run_list import listed_runs
from daemon.cli.replay import differences
from procedures.documents import read_result
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result


def test_runs_lists_every_run_with_how_it_ended(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.add_run(1, outcome="complete", verdict="pass")
    cell.add_run(2)
    done = subject("runs", "--json")
    assert done.code == 0
    assert [(r["run_id"], r["outcome"], r["verdict"]) for r in json.loads(done.out)] == [
        (1, "complete", "pass"),
        (2, "running or interrupted", None),
    ]
    assert "interrupted" in subject("runs").out


def test_no_verdict_is_told_of_a_result_that_was_altered_after_its_run(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    end = {"outcome": "complete", "verdict": "pass", "figure": {"value": 1.0}}
    altered, removed, earlier, _ = (cell.add_run(n, hand_eye_result(), **end).path for n in (1, 2, 3, 4))
    assert {row["verdict"] for row in json.loads(subject("runs", "--json").out)} == {"pass"}
    result = (altered / "result.json").read_text()
    for folder in (altered, earlier):
        (folder / "result.json").write_text(result.replace("-0.08", "-0.07"))
    (removed / "result.json").unlink()
    kept = json.loads((earlier / "end.json").read_text())
    assert kept.pop("result_sha256") == hashlib.sha256(result.encode()).hexdigest()
    (earlier / "end.json").write_text(json.dumps(kept))
    rows = json.loads(subject("runs", "--json").out)
    assert [row["verdict"] for row in rows] == ["altered", "altered", "pass", "pass"], "3 has no sum to tell"
    listed = listed_runs(altered.parent, None, 9)
    assert [(run.verdict, run.figure) for run in listed[-2:]] == [("altered", None)] * 2
    for command in ("show", "report"):
        assert "the result of run 1 was altered after the run's end; see 'cellward verify 1'" in words(
            subject(command, 1).err
        )
        assert "altered" not in subject(command, 4).err
    report = altered / "report.html"
    drawn = report.read_text("utf-8")
    assert "it is not what the job found" in drawn
    assert "NO-GO" in drawn

    # Restored with the time-stamps of before, which tell nothing.
    for name, content in (("result.json", result), ("report.html", drawn)):
        (altered / name).write_text(content)
        os.utime(altered / name, (1e9, 2e9))
    subject("report", 1)
    assert "it is not what the job found" not in report.read_text("utf-8")


def words(text: str) -> str:
    return " ".join(text.split())


def test_a_run_that_cannot_be_read_hides_no_other(cell: CellOnDisk, subject: CommandLine) -> None:
    broken = cell.add_run(1, outcome="complete")
    (broken.path / "run.json").write_text("{")
    (cell.add_run(2, outcome="complete").path / "end.json").write_text("[")
    cell.add_run(3, outcome="complete")
    strange = cell.add_run(4, outcome="complete").path / "run.json"
    strange.write_text(json.dumps(json.loads(strange.read_text()) | {"started": ["a"]}))
    rows = json.loads(subject("runs", "--json").out)
    assert [r["run_id"] for r in rows] == [1, 2, 3, 4]
    assert "unreadable" in rows[0]["outcome"]
    assert "unreadable" in rows[1]["outcome"]
    assert rows[2]["outcome"] == "complete"
    assert rows[3]["outcome"] == f"unreadable: {strange}: 'started' should be text"
    assert str(strange) in subject("runs").out.replace("\n", "")


def test_the_figures_of_a_result_are_written_as_csv(
    cell: CellOnDisk, subject: CommandLine, tmp_path: Path
) -> None:
    folder = cell.add_run(1, hand_eye_result(), outcome="complete").path
    done = subject("report", 1, "--csv")
    assert done.code == 0, done.err
    assert done.out.strip() == str(folder / "figures.csv")
    lines = (folder / "figures.csv").read_text("utf-8").splitlines()
    assert lines[0] == "key,value,unit,meaning"
    assert any(line.startswith('result.T_flange_camera[1],-0.08,"m, rad",') for line in lines)
    assert not (folder / "report.html").exists()
    elsewhere = tmp_path / "there.csv"
    assert subject("report", 1, "--csv", "-o", elsewhere).code == 0
    assert elsewhere.read_text("utf-8").splitlines() == lines
    refused = subject("report", 1, "--csv", "--pdf")
    assert refused.code == 2
    assert "leave out --pdf" in refused.err
    cell.add_run(2, outcome="aborted")
    assert "has no result" in subject("report", 2, "--csv").err


def test_an_empty_cell_has_no_runs_and_no_results_and_that_is_no_error(subject: CommandLine) -> None:
    for command in ("runs", "results"):
        text, as_json = subject(command), subject(command, "--json")
        assert (text.code, text.out, as_json.out.strip()) == (0, "", "[]")
        assert "no " in text.err


@pytest.mark.parametrize("command", ["runs", "results", "audit", "recover"])
def test_a_state_folder_that_is_a_file_is_named(command: str, cell: CellOnDisk, subject: CommandLine) -> None:
    cell.state.parent.mkdir(parents=True, exist_ok=True)
    cell.state.write_text("a file", "utf-8")
    done = subject(command)
    assert done.code == 2
    assert f"{cell.state}, [cell] state_dir of {cell.config}, is not a folder" in done.err


def test_show_tells_the_run_as_a_timeline(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.add_run(4, hand_eye_result(), outcome="complete", verdict="pass")
    shown = subject("show", 4)
    assert shown.code == 0
    for told in (
        "cone-capture", "prepare", "pose skipped", "outside the joint limits", "verdict pass", "0.123 px",
        "not resolved", "7: no target found", "camera.intrinsics", "[0.000, -80.000, 50.000] mm",
    ):  # fmt: skip
        assert told in shown.out
    whole = json.loads(subject("show", 4, "--json").out)
    assert whole["end"]["outcome"] == "complete"
    assert [line["kind"] for line in whole["journal"]] == ["header", "state", "decision", "state"]


def test_show_says_that_a_run_without_an_end_may_be_interrupted(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    cell.add_run(5)
    assert "no end" in subject("show", 5).out


@pytest.mark.parametrize("command", ["show", "report", "replay"])
def test_an_unknown_run_is_one_sentence_and_exit_code_2(subject: CommandLine, command: str) -> None:
    done = subject(command, 99)
    assert (done.code, done.out) == (2, "")
    assert "run 99" in done.err
    assert "Traceback" not in done.err


def test_a_run_number_that_is_none_is_a_usage_error(subject: CommandLine) -> None:
    assert subject("show", "latest").code == 2


def test_results_shows_what_waits_for_a_decision(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.state.mkdir()
    ledger = Ledger(cell.state / "ledger.sqlite")
    first = ledger.propose("T_flange_camera", [0.0] * 6, hand_eye_result(), 3, None)
    ledger.accept(first, "anna")
    second = ledger.propose("T_flange_camera", [0.1] * 6, hand_eye_result(), 4, None)
    ledger.close()
    states = {r["id"]: r["state"] for r in json.loads(subject("results", "--json").out)}
    assert states == {first: "committed", second: "proposed"}
    shown = subject("results")
    assert "anna" in shown.out
    assert f"cellward accept {second}" in shown.err
    assert subject("results", "T_base_camera", "--json").out.strip() == "[]"


def test_compare_finds_a_shift_of_many_sigma_significant_and_one_of_a_tenth_not(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    cell.add_run(1, hand_eye_result(), outcome="complete")
    cell.add_run(2, hand_eye_result(x_mm=1.0), outcome="complete")
    cell.add_run(3, hand_eye_result(x_mm=0.01), outcome="complete")
    far, near = (json.loads(subject("compare", 1, other, "--json").out) for other in (2, 3))
    # 1 mm against sqrt(2) * 0.1 mm; both poses have no rotation, so the distance is that of one axis.
    assert far["m2"] == pytest.approx(1.0**2 / (2 * 0.1**2))
    assert (far["significant"], near["significant"]) == (True, False)
    assert far["xi"][0] == pytest.approx(1e-3)
    assert "more than their uncertainties" in subject("compare", 1, 2).out
    assert "within what their uncertainties" in subject("compare", 1, 3).out


def test_compare_takes_the_odds_of_its_test_and_tells_them(cell: CellOnDisk, subject: CommandLine) -> None:
    cell.add_run(1, hand_eye_result(), outcome="complete")
    cell.add_run(2, hand_eye_result(x_mm=0.6), outcome="complete")  # 18 for a chi-square of six: p = 0.006
    assert "in 1 of 300 comparisons" in subject("compare", 1, 2).out
    usual, lax = (
        json.loads(subject("compare", 1, 2, "--json", *more).out) for more in ((), ("--false-alarm", 0.05))
    )
    assert (usual["significant"], usual["false_alarm"]) == (False, pytest.approx(1.0 / 300.0))
    assert (lax["significant"], lax["false_alarm"]) == (True, 0.05)
    assert lax["detectable_m"] < usual["detectable_m"]
    assert "in 1 of 20 comparisons" in subject("compare", 1, 2, "--false-alarm", 0.05).out


@pytest.mark.parametrize("chance", [0, 1, -0.5, 300, "nan"])
def test_odds_that_are_no_chance_are_refused_in_a_sentence(
    cell: CellOnDisk, subject: CommandLine, chance: object
) -> None:
    cell.add_run(1, hand_eye_result(), outcome="complete")
    cell.add_run(2, hand_eye_result(x_mm=1.0), outcome="complete")
    done = subject("compare", 1, 2, f"--false-alarm={chance}")
    assert (done.code, done.out) == (2, "")
    assert f"the false alarm {chance} is no chance; give one between 0 and 1" in done.err


def test_compare_refuses_runs_without_an_answer_of_the_same_kind(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    cell.add_run(1, hand_eye_result(), outcome="complete")
    other = hand_eye_result()
    other["result"]["T_base_camera"] = other["result"].pop("T_flange_camera")
    cell.add_run(2, other, outcome="complete")
    cell.add_run(3, outcome="aborted")
    assert "T_base_camera" in (done := subject("compare", 1, 2)).err
    assert done.code == 2
    assert "ended aborted and has no result" in subject("compare", 1, 3).err
    assert "both runs hold one and the same result" in (done := subject("compare", 1, 1)).err
    assert done.code == 2


def test_the_adjoint_carries_a_small_motion_to_the_other_side() -> None:
    import numpy as np

    from cell.poses import adjoint, exp_xi, from_pose6

    T, xi = from_pose6([0.3, -0.2, 0.5, 0.4, -0.7, 1.1]), np.array([0.01, -0.02, 0.03, 0.02, 0.01, -0.03])
    carried = T * exp_xi(xi) * T.inv()
    np.testing.assert_allclose(
        exp_xi(adjoint(T.as_matrix()) @ xi).as_matrix(), carried.as_matrix(), atol=1e-12
    )


def test_replay_compares_within_a_billionth_of_each_array() -> None:
    recorded: dict[str, Any] = hand_eye_result()
    same = json.loads(json.dumps(recorded))
    same["inputs"]["solve_seconds"] = 9.0
    same["result"]["T_flange_camera"][1] *= 1 + 1e-10
    same["result"]["T_flange_camera"][3] += 1e-12  # rounding beside a component of 0.08
    assert differences(recorded, same) == []
    same["result"]["T_flange_camera"][1] *= 1 + 1e-8
    same["verdict"] = "warn"
    assert [d["where"] for d in differences(recorded, same)] == ["verdict", "result.T_flange_camera[1]"]


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r["result"].pop("cov"),
        lambda r: r["result"]["rejected"].append({"index": 8, "reason": "blur"}),
        lambda r: r.update(result=None),
        lambda r: r["result"]["spread_within"].update(resolved=True),
    ],
)
def test_replay_sees_what_is_missing_or_of_another_form(change: Any) -> None:
    other = json.loads(json.dumps(hand_eye_result()))
    change(other)
    assert len(differences(hand_eye_result(), other)) == 1


def test_replay_tells_figures_that_were_not_recorded_from_those_that_differ(
    cell: CellOnDisk, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.add_run(1, hand_eye_result(), outcome="complete")
    now = hand_eye_result()
    now["heldout"]["later_figure"] = 0.25
    monkeypatch.setattr("procedures.replay.solve_again", lambda *_: read_result(now))
    ran = subject("replay", 1)
    assert (ran.code, ran.out) == (
        0,
        "run 1 replays: every figure is within 1e-09 of what was recorded\n",
    )
    assert "An earlier version did not record these figures: heldout.later_figure." in ran.err
    said = json.loads(subject("replay", 1, "--json").out)
    assert (said["same"], said["differences"], said["not_recorded"]) == (True, [], ["heldout.later_figure"])
    now["residuals"]["reprojection_rms_px"] = 0.124
    assert subject("replay", 1).code == 1


def test_report_prints_the_path_of_the_report_that_is_there(cell: CellOnDisk, subject: CommandLine) -> None:
    run = cell.add_run(1, hand_eye_result(), outcome="complete")
    (run.path / "report.html").write_text("<html>")
    done = subject("report", 1)
    assert (done.code, done.out.strip()) == (0, str(run.path / "report.html"))


def test_listing_the_runs_starts_without_numbers_and_event_loop(cell: CellOnDisk) -> None:
    cell.add_run(1, outcome="complete")
    script = (
        "import sys; sys.argv = ['cellward', 'runs', '--config', sys.argv[1]]\n"
        "from daemon.cli import main\n"
        "code = main()\n"
        "heavy = {'numpy', 'asyncio'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(cell.config)], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "cone-capture" in done.stdout


def test_a_run_without_a_result_has_a_report_that_tells_why_it_ended(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    run = cell.add_run(8)
    run.note("device", event="interrupted", step="pose 4", cause="STALE_DATA", why="arm: 0.136 s old")
    run.note("decision", event="step taken again", step="pose 4", lost_s=0.2)
    failure = error("STALE_DATA", "arm: newest sample is 0.136 s old, limit 0.100 s <script>")
    run.finish({"outcome": "aborted", "packml": "ABORTED", "verdict": None, "error": failure.as_dict()})
    done = subject("report", 8)
    assert (done.code, done.out.strip()) == (0, str(run.path / "report.html"))
    text = (run.path / "report.html").read_text()
    assert "Run 8 (cone-capture) ended aborted, without a result" in text
    assert "newest sample is 0.136 s old, limit 0.100 s &lt;script&gt;" in text
    for told in (f"code {failure.code}", "pose 4: arm: 0.136 s old", "outside the joint limits", "ABORTED"):
        assert told in text, told
    assert escape(failure.hint) in text


def test_a_report_of_a_run_that_goes_on_is_drawn_again_when_it_has_a_result(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    run = cell.add_run(9)
    assert subject("report", 9).code == 0
    path = run.path / "report.html"
    assert "has no end" in path.read_text()
    run.write_result(hand_eye_result())
    assert subject("report", 9).code == 0
    assert "without a result" not in path.read_text()
