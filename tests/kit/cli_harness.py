"""What the tests of the command line share: running it in this process, and a cell on disk."""

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
import typer.main

from cell.clock import MonotonicClock
from cell.store.runs import RunFolder
from daemon.cli import main
from tests.kit.whole_results import whole

SHELL_DETECTION = "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"  # typer looks at it as it makes commands
_make_command = typer.main.get_command


def _command_of(app: typer.Typer) -> Any:
    """Made once: typer makes all commands anew for each command line."""
    return _kept_command(app, os.environ.get(SHELL_DETECTION))


@cache
def _kept_command(app: typer.Typer, _: str | None) -> Any:
    return _make_command(app)


@dataclass
class Ran:
    """What one command line left behind."""

    code: int
    out: str
    err: str


@dataclass
class CommandLine:
    """``command("runs", "--json")`` as a shell would run it, in this process; without a ``config`` the
    environment names none."""

    monkeypatch: pytest.MonkeyPatch
    capsys: pytest.CaptureFixture[str]
    config: Path | None

    def __call__(self, *words: object) -> Ran:
        self.monkeypatch.setattr("sys.argv", ["cellward", *map(str, words)])
        if self.config is None:
            self.monkeypatch.delenv("CELLWARD_CONFIG", raising=False)
        else:
            self.monkeypatch.setenv("CELLWARD_CONFIG", str(self.config))
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            self.monkeypatch.setenv(name, "1")
        self.monkeypatch.setattr(typer.main, "get_command", _command_of)
        self.capsys.readouterr()
        code = main()
        captured = self.capsys.readouterr()
        return Ran(code, captured.out, captured.err)


class CellOnDisk:
    """A folder with a cell.toml and a state folder."""

    def __init__(self, folder: Path) -> None:
        self.state = folder / "state"
        self.socket = folder / "control.sock"
        self.config = folder / "cell.toml"
        self.config.write_text(
            f'schema = 1\n[cell]\nstate_dir = "{self.state}"\ncontrol_socket = "{self.socket}"\n'
        )

    def add_run(self, run_id: int, result: dict[str, Any] | None = None, **end: Any) -> RunFolder:
        """A run with a short journal; ``end`` left out means interrupted."""
        run = RunFolder.create(
            self.state / "runs", "cone-capture", run_id, {"parameters": {"settle_s": "0.5"}}, MonotonicClock()
        )
        run.note("state", state="prepare", why="")
        run.note("decision", event="pose skipped", pose=3, why="outside the joint limits")
        if result is not None:
            run.write_result(result)
        if end:
            run.note("state", terminal=True, **end)
            run.finish(end)
        run.close()
        return run


def hand_eye_result(x_mm: float = 0.0, verdict: str = "pass") -> dict[str, Any]:
    """A result document whose camera is ``x_mm`` away from the flange, with 0.1 mm and 0.1 mrad."""
    cov = [[1e-8 * (i == j) for j in range(6)] for i in range(6)]
    named = {
        "schema": "cellward.result/1",
        "kind": "hand-eye",
        "verdict": verdict,
        "reasons": ["spread above its limit"] if verdict == "fail" else [],
        "warnings": [{"code": "camera.intrinsics", "text": "K does not fit the images"}],
        "result": {
            "T_flange_camera": [1e-3 * x_mm, -0.08, 0.05, 0.0, 0.0, 0.0],
            "cov": cov,
            "rejected": [{"index": 7, "reason": "no target found"}],
            "spread_within": {
                "t": [0, 0, 0], "t_norm": 0.0012, "r": 0.001, "floor_t": 0.001, "floor_r": 0.001,
                "resolved": False,
            },
        },
        "uncertainty": {},
        "residuals": {"reprojection_rms_px": 0.123, "loo_mean": {"t": 0.0004, "r": 0.0002}},
        "heldout": {},
        "observability": {},
        "inputs": {"solve_seconds": 0.01},
    }  # fmt: skip
    return whole(named)
