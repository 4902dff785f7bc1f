"""What a person is told to do next: after a run, in the status, and in the report."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cell.formats.result import Result, Verdict
from daemon.cli.next_step import next_commands, possible
from daemon.cli.status_text import change_line, status_text, without_state
from daemon.stored_result import summary_of
from daemon.words.result_text import result_text
from daemon.words.value_text import value_text
from procedures.kind import OUTSIDE, Kind
from procedures.report.source import Source
from procedures.report.verdict import banner
from tests.kit.whole_results import whole

END: dict[str, Any] = {"run_id": 5, "job": "cone-capture", "outcome": "complete", "verdict": "pass"}
WAITS = [{"id": 2, "name": "T_flange_camera", "run_id": 5}]
STATUS: dict[str, Any] = {"cell": "bay-3", "packml": "COMPLETE", "devices": {}, "job": None}


def test_a_result_that_waits_is_named_with_both_commands() -> None:
    words = "To decide about T_flange_camera: cellward accept 2, or cellward reject 2."
    assert next_commands(END, WAITS) == [words]
    assert words in status_text({**STATUS, "last_run": END, "waiting": WAITS})


def test_a_result_with_warnings_is_accepted_by_another_command() -> None:
    (words,) = next_commands({**END, "verdict": "warn"}, WAITS)
    assert "cellward accept 2 --warned" in words


def test_a_moved_tool_leads_to_its_correction() -> None:
    result = {"result": {"moved": {"moved": True}}, "reasons": ["tool moved: by 1.49 mm"]}
    end = {**END, "verdict": "fail", "result": result}
    assert next_commands(end, []) == [
        "The tool has moved. To correct its frame: cellward start laser-update."
    ]
    assert "tool moved: by 1.49 mm" in status_text({**STATUS, "last_run": end})
    assert next_commands({**END, "result": {"result": {"moved": {"moved": False}}}}, []) == []


def test_results_of_earlier_runs_are_told_in_the_status_alone() -> None:
    older = [{"id": 1, "name": "belt.encoder", "run_id": 3}]
    assert next_commands(END, older) == []
    assert "cellward accept 1, or cellward reject 1" in status_text({**STATUS, "waiting": older})


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({}, "cellward start JOB"),
        ({"latched": True}, "cellward reset"),
        ({"job": "cone-capture", "packml": "EXECUTE"}, "cellward pause, cellward finish, cellward abort"),
        ({"job": "cone-capture", "packml": "HELD"}, "cellward resume"),
        ({"job": "cone-capture", "packml": "HELD", "prompt": {"id": 9, "text": "?"}}, "cellward confirm 9"),
        ({"job": "cone-capture", "packml": "ABORTING"}, "wait for its end"),
    ],
)
def test_the_status_names_the_commands_that_are_possible(state: dict[str, Any], words: str) -> None:
    assert words in possible({**STATUS, **state})


def test_a_status_has_the_count_of_a_sampled_arms_parameters_and_no_table() -> None:
    known = {"kind": "kincal", "observability": {"parameters": 32, "jacobian": [0.0] * 9}, "result": {}}
    live = summary_of(known)
    assert live is not None
    assert live["observability"] == {"parameters": 32}


def test_a_watch_tells_a_job_that_goes_to_and_fro_once_a_step() -> None:
    run = {**STATUS, "packml": "EXECUTE", "job": "laser-reference", "run_id": 1, "step": 0, "steps": 18}
    sweep, back = ({**run, "state": name} for name in ("sweep", "return"))
    assert change_line(sweep) != change_line(back)
    assert without_state(sweep) == without_state(back)
    assert without_state(sweep) != without_state({**sweep, "step": 1})


def report_of(journal: list[dict[str, Any]], verdict: Verdict = "pass") -> str:
    result = Result(kind="hand-eye", verdict=verdict, result={"x": 1})
    entries = [{"kind": "decision", **entry} for entry in journal]
    return str(banner(Source(result, journal=json.loads(json.dumps(entries))), {}, ""))


def test_the_report_names_the_commands_that_decide(tmp_path: Path) -> None:
    proposed = {"event": "proposed", "name": "T_flange_camera", "result_id": 2}
    assert "cellward accept 2</code> or <code>cellward reject 2" in report_of([proposed])
    assert "cellward accept 2 --warned" in report_of([proposed], "warn")
    by_policy = report_of([proposed, {**proposed, "event": "accepted", "by": "policy"}])
    assert "Result 2 (T_flange_camera) was accepted by policy" in by_policy
    assert "cellward accept" not in by_policy
    assert "cellward" not in report_of([])


@pytest.mark.parametrize(
    "named",
    [
        {"kind": "belt-calibration", "result": {"m_per_count_95": None, "dir_95_rad": None}},
        {"kind": "belt-tracking", "result": {"success": None, "picks_per_minute": None}},
        {"kind": "kincal", "result": {"rms_nominal": None, "rms_calibrated": None}},
        {"kind": "laser", "result": {"drot_flange": None, "tau": None, "cov": None}, "uncertainty": {}},
    ],
    ids=lambda named: str(named["kind"]),
)
def test_what_was_not_measured_is_left_out_or_unknown_and_never_none(named: dict[str, Any]) -> None:
    assert "None" not in result_text(whole({"verdict": "pass", **named}))


def test_a_value_that_does_not_say_something_is_unknown_and_never_none() -> None:
    lines = value_text("kinematics.arm", {"schema": "cellward.kinematics/1"})
    assert "unknown" in lines
    assert "None" not in lines


def test_a_document_in_the_ledger_is_told_by_the_words_of_its_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = Kind(name="acme:MAP", words="", values=(("acme.map/2", f"{__name__}:size_of_map"),))
    monkeypatch.setitem(OUTSIDE, kind.name, kind)
    assert value_text("map.arm", {"schema": "acme.map/2", "size": 7}) == "a map of 7 cells"
    assert value_text("map.arm", {"schema": "acme.maps/2", "size": 7}) == "acme.maps/2 with 2 entries"


def test_a_document_is_told_by_the_words_of_a_package_that_is_installed(tmp_path: Path) -> None:
    """In a process that has not asked for the jobs, as ``cellward results``."""
    (tmp_path / "acme_maps-1.dist-info").mkdir()
    told = tmp_path / "acme_maps-1.dist-info"
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-maps\nVersion: 1\n", "utf-8")
    (told / "entry_points.txt").write_text("[cellward.procedures]\nacme-map = acme_map:Map\n", "utf-8")
    (tmp_path / "acme_map.py").write_text(PACKAGE, "utf-8")
    document = {"schema": "acme.map/2", "size": 7}
    code = f"from daemon.words.value_text import value_text; print(value_text('map.arm', {document}))"
    path = f"{tmp_path}:{Path(__file__).parents[3]}"
    subject = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONPATH": path}, capture_output=True, text=True, check=True
    )
    assert subject.stdout == "a map of 7 cells\n"


PACKAGE = """
from pydantic import BaseModel
from cell.procedure import Procedure
from procedures.kind import Kind

def told(value):
    return f"a map of {value['size']} cells"

KIND = Kind(name="acme_map:KIND", words="", module="acme_map", values=(("acme.map/2", ":told"),))

class Map(Procedure):
    name, number, kind, Config = "acme-map", 1002, KIND.name, BaseModel
    State, TRANSITIONS, CHECKPOINTS = None, {}, frozenset()

    def uses(self):
        return ()

    async def run(self, run):
        pass

    async def dry_run(self, run):
        return {}
"""


def size_of_map(value: dict[str, int]) -> str:
    return f"a map of {value['size']} cells"
