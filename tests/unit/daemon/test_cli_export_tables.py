"""``cellward export --parquet``: what a plant's tools read of a cell, read back with pyarrow itself."""

import sys
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from cell.clock import MonotonicClock
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result

CAMERA = [0.001, -0.08, 0.05, 0.1, 0.2, 0.3]
DIGEST = "ab" * 32
FIGURE = {"name": "error95_t_m", "words": "95 % error", "value": 2.8e-4, "unit": "m", "uncertainty": None}


@pytest.fixture
def cell(tmp_path: Path) -> CellOnDisk:
    """A cell with a run that found a camera, one that failed, and a result whose run was pruned."""
    made = CellOnDisk(tmp_path)
    info = {
        "config": {"cell": {"name": "bay-3", "twin": True}},
        "config_digest": DIGEST,
        "versions": {"cellward": "0.1.0"},
        "started_by": {"who": "anna", "channel": "web"},
        "recipe": "left-bay",
        "values": {"tool": {"name": "needle"}},
    }
    lost = {"code": 3001, "text": "The arm is lost", "hint": "Look."}
    for number, result, end in (
        (1, hand_eye_result(x_mm=1.0), {"outcome": "complete", "verdict": "pass", "figure": FIGURE}),
        (2, None, {"outcome": "aborted", "verdict": None, "error": lost}),
    ):
        run = RunFolder.create(made.state / "runs", "cone-capture", number, info, MonotonicClock())
        if result is not None:
            run.write_result(result)
        run.finish({"packml": None, **end})
    with closing(Ledger(made.state / "ledger.sqlite")) as ledger:
        first = ledger.propose("T_flange_camera", CAMERA, hand_eye_result(x_mm=1.0), 1, None)
        ledger.accept(first, "anna", why="as before")
        ledger.propose("belt_scale.belt", {"m_per_count": 2e-5, "dir": [1.0, 0.0, 0.0]}, {}, 1, None)
        ledger.propose("time_offset_s.camera", 0.012, {"kind": "latency", "verdict": "warn"}, 7, None)
    return made


def lines(path: Path) -> list[dict[str, Any]]:
    return pq.read_table(path, use_threads=False).to_pylist()


def test_runs_and_results_are_typed_tables_that_name_their_cell(subject: CommandLine, tmp_path: Path) -> None:
    done = subject("export", "--parquet", tmp_path / "bay-3.parquet")
    assert done.code == 0, done.err
    types = {field.name: str(field.type) for field in pq.read_schema(tmp_path / "bay-3.results.parquet")}
    assert (types["x_m"], types["proposed"], types["run_id"]) == ("double", "timestamp[us, tz=UTC]", "int64")
    found, failed = lines(tmp_path / "bay-3.runs.parquet")
    assert (found["cell"], found["twin"], found["config_sha256"]) == ("bay-3", True, DIGEST)
    assert (found["job"], found["kind"], found["verdict"]) == ("cone-capture", "hand-eye", "pass")
    assert (found["recipe"], found["tool"]) == ("left-bay", "needle")
    assert (found["figure"], found["figure_value"], found["figure_unit"]) == ("error95_t_m", 2.8e-4, "m")
    assert dict(found["figures"])["residuals.reprojection_rms_px"] == 0.123
    assert abs(datetime.now(UTC) - found["started"]).total_seconds() < 3600.0
    assert (failed["outcome"], failed["cause"], failed["figures"]) == ("aborted", "The arm is lost", [])


def test_a_pose_is_six_numbers_with_uncertainty_and_decision(subject: CommandLine, tmp_path: Path) -> None:
    assert subject("export", "--parquet", tmp_path / "line.4").code == 0
    camera, belt, delay = lines(tmp_path / "line.4.results.parquet")
    assert [camera[k] for k in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")] == CAMERA
    # 0.1 mm along each axis: 95 % of a normal error in space stay within 2.795 sigma.
    assert camera["error_95_m"] == pytest.approx(2.795e-4, rel=1e-3)
    assert (camera["state"], camera["decided_by"], camera["why"]) == ("committed", "anna", "as before")
    assert [row["time_offset_s"] for row in (camera, belt, delay)] == [None, None, 0.012]
    assert (belt["m_per_count"], belt["cell"], delay["x_m"]) == (2e-5, "bay-3", None)
    # The folder of run 7 is gone: the name is the configured one, the digest of its configuration unknown.
    assert (delay["cell"], delay["config_sha256"], delay["verdict"]) == ("cell", None, "warn")
    assert delay["error_95_m"] is None


def test_an_empty_store_gives_tables_without_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)
    assert empty("export", "--parquet", tmp_path / "x").code == 0
    assert lines(tmp_path / "x.runs.parquet") == lines(tmp_path / "x.results.parquet") == []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("T_flange_camera", "--parquet", "x"), "leave out NAME"),
        ((), "give NAME and --format, or --parquet FILE"),
        (("--parquet", "/nowhere/x"), "the folder /nowhere does not exist"),
    ],
)
def test_what_does_not_go_together_is_told(subject: CommandLine, words: tuple[str, ...], told: str) -> None:
    done = subject("export", *words)
    assert done.code == 2
    assert told in done.err


def test_without_pyarrow_the_extra_is_named(
    subject: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    done = subject("export", "--parquet", tmp_path / "x")
    assert done.code == 2
    assert "install the extra cellward[parquet]" in done.err
