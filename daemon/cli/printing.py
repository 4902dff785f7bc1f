"""``cellward report --pdf``: a report printed to A4 by a browser that is installed, without a window."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from cell.errors import error
from cell.store.files import write_atomic

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge")
VARIABLE = "CELLWARD_BROWSER"
TIMEOUT_S = 180.0


def print_pdf(report: Path, target: Path | None = None) -> Path:
    """Print ``report`` to the PDF ``target``, beside it unless given; returns where that is.

    ``ARGUMENT_INVALID`` says what to install, or how the browser failed; ``DISK_FULL``, ``DISK_FAILED``.
    """
    browser = _browser()
    target = target or report.with_suffix(".pdf")
    with tempfile.TemporaryDirectory(prefix="cellward-") as place:
        printed = Path(place) / target.name
        command = [
            browser,
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--disable-extensions",
            "--disable-background-networking",
            "--no-pdf-header-footer",
            f"--user-data-dir={place}/profile",
            f"--print-to-pdf={printed}",
            report.absolute().as_uri(),
        ]
        if os.geteuid() == 0:  # it refuses to run as root with its sandbox; the page may load nothing anyway
            command.insert(1, "--no-sandbox")
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=TIMEOUT_S, errors="replace"
            )
        except subprocess.TimeoutExpired:
            raise error(
                "ARGUMENT_INVALID", f"--pdf: {browser} did not print {report} in {TIMEOUT_S:g} s"
            ) from None
        if done.returncode != 0 or not printed.exists():
            told = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            raise error("ARGUMENT_INVALID", f"--pdf: {browser} did not print {report}: {told}")
        write_atomic(target, printed.read_bytes())
    return target


def _browser() -> str:
    named = os.environ.get(VARIABLE)
    found = next((path for name in ([named] if named else BROWSERS) if (path := shutil.which(name))), None)
    if found is None:
        wanted = f"{VARIABLE} names '{named}', which" if named else f"none of {', '.join(BROWSERS)}"
        raise error(
            "ARGUMENT_INVALID",
            f"--pdf: {wanted} is not installed; 'apt install chromium', or open the report in any browser "
            "and print it: it is laid out for A4",
        )
    return found
