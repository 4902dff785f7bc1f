"""The page's API of a whole daemon: what it tells of runs, results, trends, the cell and its registers."""

import re

import pytest

from tests.kit.page_cell import TOKENS, PageCell

pytestmark = pytest.mark.wire


def test_runs_are_listed_newest_first_with_who_started_them(subject: PageCell) -> None:
    assert [(run["run_id"], run["outcome"], run["who"]) for run in subject.get("/api/runs")] == [
        (3, "complete", "anna"),
        (2, "aborted", "anna"),
        (1, "complete", "anna"),
    ]


def test_a_run_in_the_list_has_its_main_figure_and_what_became_of_its_results(subject: PageCell) -> None:
    newest, failed, complete = subject.get("/api/runs")
    assert (failed["cause"], failed["figure"], failed["report"]) == ("The arm is lost", None, False)
    assert (complete["figure"]["value"], complete["figure"]["unit"]) == (3.1e-4, "m")
    assert complete["report"]
    decided = [[(row["state"], row["who"]) for row in run["decided"]] for run in (complete, newest)]
    assert decided == [[("committed", "anna")], [("proposed", None)]]


def test_a_failed_run_tells_its_cause_and_its_journal(subject: PageCell) -> None:
    run = subject.get("/api/runs/2")
    assert run["error"]["text"] == "The arm is lost"
    assert "start" in run["journal"]
    assert subject.get("/api/runs/77")["error"]["name"] == "NOT_FOUND"


def test_two_results_of_one_kind_are_compared_as_the_command_line_does(subject: PageCell) -> None:
    assert [run["compared_as"] for run in subject.get("/api/runs")] == ["hand-eye", None, "hand-eye"]
    found = subject.get("/api/runs/3/against/1")
    across = found["rows"][0]
    assert (across["name"], across["unit"]) == ("x", "m")
    assert across["difference"] == pytest.approx(1e-3)
    assert across["sigma"] == pytest.approx(2**0.5 * 1e-4)
    assert found["figures"]["significant"]
    assert found["words"].startswith("T_flange_camera: run 3 against run 1")
    assert [row["first"] for row in found["rows"] if row["name"] == "spread_within_t"] == [0.0012]
    assert "run 2" in subject.get("/api/runs/2/against/1")["error"]["text"]


def test_a_report_is_shown_in_a_sandbox_that_can_ask_the_cell_nothing(subject: PageCell) -> None:
    assert "<title>report</title>" in subject.get("/api/runs/1/report")
    policy = subject.headers("/api/runs/1/report")["Content-Security-Policy"]
    assert policy.startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in policy
    assert "default-src 'none'" in policy
    assert subject.get("/api/runs/2/report")["error"]["name"] == "NOT_FOUND"


def test_pictures_are_given_by_name_and_nothing_else_of_the_disk_is(subject: PageCell) -> None:
    assert subject.headers("/api/runs/1/picture/0000-0-0.png")["Content-Type"] == "image/png"
    for name in ("..%2frun.json", "%2e%2e%2frun.json", "run.json", "..", "%2fetc%2fpasswd", "x.png"):
        answer = subject.get(f"/api/runs/1/picture/{name}")
        assert "schema" not in str(answer)
        assert "root:" not in str(answer)
        assert answer == "404 Not Found" or answer["error"]["name"] == "NOT_FOUND", name


def test_a_result_shows_what_was_before_what_changes_and_its_warnings(subject: PageCell) -> None:
    found = subject.get("/api/results")
    assert [(entry["id"], entry["state"], entry["why"]) for entry in found] == [
        (2, "proposed", None),
        (1, "committed", "the first one"),
    ]
    waiting = subject.get("/api/results/2")
    assert waiting["before"]["pose"] == [0.0, -0.08, 0.05, 0.0, 0.0, 0.0]
    assert waiting["before_version"] == 1
    assert waiting["warnings"]
    assert "in effect from the next job on" in waiting["use"]
    assert {figure["name"]: figure["value"] for figure in waiting["figures"]}["error95_t_m"] == 0.00031


def test_trends_come_oldest_first_in_si_units(subject: PageCell) -> None:
    trend = subject.get("/api/trends")["trends"]["tool.offset_x_m.gripper"]
    assert [value for _, value in trend["points"]] == [0.0001, 0.0002, 0.0004]


def test_a_trend_has_the_limit_of_the_job_that_leaves_it(subject: PageCell) -> None:
    trend = subject.get("/api/trends")["trends"]["tool.offset_x_m.gripper"]
    assert (trend["limit"], trend["key"]) == (0.003, "[job.laser-check] against_reference.max_shift_m")


def test_every_job_says_what_keeps_it_from_starting(subject: PageCell) -> None:
    jobs = {job["name"]: job for job in subject.get("/api/jobs")}
    assert jobs["cone-capture"]["last"]["run_id"] == 3
    assert all(job["obstacle"] is not None for job in jobs.values())  # there is no device at all
    assert not any(job["configured"] for job in jobs.values())


@pytest.mark.restarts_children  # the daemon's: the process that predicts lives on for a minute
def test_what_check_expects_of_a_job_is_told_before_it_starts(subject: PageCell) -> None:
    found = subject.get("/api/jobs/latency-calibration/expected")["expected"]
    assert found["problems"][0].startswith("[robot] names no device for belt")
    assert found["limits"] == []
    assert subject.get("/api/jobs/cone-capture/expected") == {"expected": None}  # it has no section
    assert subject.get("/api/jobs/polish/expected")["error"]["name"] == "NOT_FOUND"


def test_registers_and_who_may_write_are_shown(subject: PageCell) -> None:
    registers = {register["name"]: register for register in subject.get("/api/plc")["registers"]}
    assert registers["packml_state"]["words"] == "idle"
    assert "twin" in registers["status"]["bits"]
    writers = subject.get("/api/cell")["writers"]
    assert writers["users"] == {"vera": "viewer", "otto": "operator", "ida": "integrator"}
    assert writers["modbus"] is None


def test_no_answer_to_a_visitor_holds_a_digest_of_a_token_or_the_log(subject: PageCell) -> None:
    for path in ("/api/cell", "/api/me", "/api/runs/1", "/api/jobs"):
        assert re.search(r"[0-9a-f]{64}", str(subject.get(path))) is None, path
    assert subject.get("/api/log")["error"]["name"] == "LOGIN_NEEDED"


def test_metrics_are_in_the_format_of_prometheus(subject: PageCell) -> None:
    text = subject.get("/metrics", Authorization=f"Bearer {TOKENS['vera']}")
    assert 'cellward_info{cell="bay-3"' in text
    assert "cellward_results_waiting 1.0" in text
    assert "\ncellward_packml_state 4.0" in text


def test_the_arm_that_is_not_there_is_refused_in_words(subject: PageCell) -> None:
    assert subject.get("/api/joints")["error"]["name"] == "DEVICE_NOT_READY"
