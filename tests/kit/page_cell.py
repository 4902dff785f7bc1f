"""A daemon with its page as a process: no devices, and a store that holds runs, results and trends."""

import json
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from cell.clock import MonotonicClock
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from tests.kit.cli_harness import hand_eye_result
from tests.kit.page_rig import ROLES, TOKENS, http_section

BIN = Path(sys.executable).parent
POSE = [0.0, -0.08, 0.05, 0.0, 0.0, 0.0]
FOUND = [0.001, -0.081, 0.052, 0.001, 0.0, 0.002]
FIGURE = {"name": "error95_t_m", "words": "95 % error of the place", "value": 3.1e-4, "unit": "m"}
WARNED = {"code": "target.scale", "text": "the board is printed 0.2 % too large"}


class PageCell:
    """The process, and requests to its page."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.url = folder, free_url()
        self.config = folder / "cell.toml"
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with (self.folder / "daemon.log").open("ab") as log:
            command = [str(BIN / "cellward"), "run", "--config", str(self.config)]
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        give_up = time.monotonic() + 120.0
        while True:
            with suppress(OSError):
                self.get("/api/me")
                return
            assert time.monotonic() < give_up, (self.folder / "daemon.log").read_text()
            time.sleep(0.05)

    def stop(self) -> None:
        if self.process is not None:
            self.process.terminate()
            self.process.wait(20.0)
            self.process = None

    def get(self, path: str, **headers: str) -> Any:
        """What the page's API answers; an error's document for a refusal."""
        request = urllib.request.Request(self.url + path, headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=20.0) as answer:
                content = answer.read()
        except urllib.error.HTTPError as refused:
            content = refused.read()
            refused.close()
        with suppress(ValueError):
            return json.loads(content)
        return content.decode()

    def headers(self, path: str) -> dict[str, str]:
        with urllib.request.urlopen(self.url + path, timeout=20.0) as answer:
            return dict(answer.headers)


def free_url() -> str:
    """An address on which a page can listen."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{probe.getsockname()[1]}"


def page_section(url: str) -> str:
    """``[http]`` of a cell that all may watch, with the rig's users."""
    users = "".join(
        f'[http.user.{name}]\nrole = "{ROLES[name]}"\ntoken_sha256 = "{user.token_sha256}"\n'
        for name, user in http_section().user.items()
    )
    return f'\n[http]\nbind = "{url.removeprefix("http://")}"\nlook_without_login = true\n{users}'


def write_config(cell: PageCell) -> None:
    cell.config.write_text(
        f'schema = 1\n[cell]\nname = "bay-3"\ntwin = true\nstate_dir = "{cell.folder / "state"}"\n'
        f'control_socket = "{cell.folder / "control.sock"}"\n'
        f"[robot]\nT_flange_camera_nominal = {POSE}\n[modbus]\nenabled = false\n[poses]\nhome = {[0.0] * 6}\n"
        f'[job.latency-calibration]\nsource = "belt"\nbelt_z_m = 0.1\n'
        f"{page_section(cell.url)}",
        "utf-8",
    )
    cell.config.chmod(0o600)


def fill_store(state: Path) -> None:
    """Three runs, of which the second failed; a result in effect, one that waits with a warning; a trend."""
    with closing(Ledger(state / "ledger.sqlite")) as ledger:
        lost = {"text": "The arm is lost", "hint": "Look."}
        for outcome, error, x_mm in (
            ("complete", None, 0.0),
            ("aborted", lost, 0.0),
            ("complete", None, 1.0),
        ):
            number = ledger.next_run_id()
            folder = RunFolder.create(state / "runs", "cone-capture", number, {}, MonotonicClock())
            ledger.start_run(number, "cone-capture", folder.path.name, "anna", "control")
            folder.note("operator", event="start", who="anna")
            if outcome == "complete":
                folder.write_result(hand_eye_result(x_mm))
                (folder.path / "report.html").write_text("<title>report</title><script>var a = 1</script>")
                (folder.path / "images").mkdir()
                (folder.path / "images/0000-0-0.png").write_bytes(b"\x89PNG\r\n\x1a\n")
            figure = FIGURE if outcome == "complete" else None
            folder.finish(
                {"outcome": outcome, "packml": "COMPLETE", "verdict": None, "error": error, "figure": figure}
            )
            ledger.end_run(number, outcome, None)
        known = {"kind": "hand-eye", "verdict": "warn", "reasons": [WARNED["text"]], "warnings": [WARNED]}
        certain = {"uncertainty": {"error95_t_m": 0.00031, "error95_r_rad": 0.0004}}
        first = ledger.propose("T_flange_camera", POSE, {"kind": "hand-eye", "verdict": "pass"}, 1, POSE)
        ledger.accept(first, "anna", why="the first one")
        ledger.propose("T_flange_camera", FOUND, {**known, **certain}, 3, POSE)
        for value in (0.0001, 0.0002, 0.0004):
            ledger.add_trend("tool.offset_x_m.gripper", value)


@contextmanager
def page_cell(folder: Path) -> Iterator[PageCell]:
    cell = PageCell(folder)
    write_config(cell)
    (folder / "state/runs").mkdir(parents=True)
    fill_store(folder / "state")
    cell.start()
    try:
        yield cell
    finally:
        cell.stop()


__all__ = ["TOKENS", "PageCell", "page_cell"]
