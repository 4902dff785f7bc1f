"""The processes of the demo: each is started from its console script, and ended whatever happens."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

from cell.errors import error
from cell.priority import weigh_session

TERM_DEADLINE_S = 15.0
KILL_DEADLINE_S = 5.0
LAST_LINES = 6
SERVICE_NICE = -5  # as in daemon/service/files/cellward.service
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def console_script(name: str) -> Path:
    """An installed command of the same venv; ``FILE_MISSING`` when there is none."""
    path = Path(sys.executable).with_name(name)
    if not path.exists():
        raise error("FILE_MISSING", f"the command {name} is not installed beside {sys.executable}")
    return path


class Child:
    """``with Child("twin", command, log) as child``: at the end of the block the process is gone.

    Twin and daemon have the priority that the service has, where the system permits it: the default ``nice``.
    """

    def __init__(self, name: str, command: list[str], log: Path, nice: int = SERVICE_NICE) -> None:
        self.name, self._command, self._log, self._nice = name, command, log, nice

    def __enter__(self) -> Self:
        with self._log.open("wb") as log:
            # A session of its own: Ctrl-C reaches only the demo, which then ends its children in order.
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=partial(_end_with_parent, self._nice),
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    @property
    def pid(self) -> int:
        return self._process.pid

    def wait_for(self, condition: Callable[[], bool], what: str, timeout: float) -> None:
        """Poll until ``condition``; the error tells the child's last words if it ends or takes too long."""
        give_up = time.monotonic() + timeout
        while not condition():
            self.check_alive()
            if time.monotonic() > give_up:
                raise error(
                    "CALL_TIMEOUT", f"the {self.name}: no {what} in {timeout:g} s; {self.last_words()}"
                )
            time.sleep(0.05)

    def check_alive(self, patience: float = 0.0) -> None:
        """``CHILD_DIED`` with its last words if it is gone, or goes within ``patience`` seconds."""
        with suppress(subprocess.TimeoutExpired):
            code = self._process.wait(patience)
            raise error("CHILD_DIED", f"the {self.name} ended with code {code}; {self.last_words()}")

    def ended(self, timeout: float) -> bool:
        """Whether it has ended by itself within ``timeout`` seconds."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)
        return self._process.poll() is not None

    def come_forward(self) -> None:
        """Stand back from other programs no longer, where the system permits it."""
        weigh_session(0, self.pid)

    def end(self) -> None:
        """SIGTERM with a deadline, then SIGKILL to whatever is left of its session."""
        if self._process.poll() is None:
            self._process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(TERM_DEADLINE_S)
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait(KILL_DEADLINE_S)

    def last_words(self) -> str:
        """The end of its log."""
        lines = self._log.read_text("utf-8", "replace").strip().splitlines()[-LAST_LINES:]
        return f"its log {self._log} ends: " + " / ".join(line.strip() for line in lines)


def _end_with_parent(nice: int) -> None:
    """Runs in the child before exec: even a killed demo leaves no process."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, nice)
    weigh_session(nice)
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
