"""What of the demo runs on objects, in processes of their own beside the steps on real protocols: the steps
that have no protocol, and all of them once more in ideal worlds."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from cell.errors import CellError
from cell.store.files import disk_errors, read_json
from daemon.cli.failures import FAILED
from daemon.cli.output import say
from daemon.demo.children import Child, console_script
from daemon.demo.closing import Row
from daemon.demo.fast import ROWS_FILE, STATE
from daemon.demo.scenes import scenes_of
from daemon.demo.steps import Step
from daemon.report_index import CellState

FOLDER, IDEAL_FOLDER = "objects", "ideal"
NICE, NICE_IDEAL = 10, 15  # twin and daemon come first, while there are any
LONGEST_S = 600.0


class ObjectSteps:
    """These steps on objects, with their files in a folder of their own in ``folder``; on request in ideal
    worlds."""

    def __init__(self, folder: Path, steps: Sequence[Step], ideal: bool = False) -> None:
        name = IDEAL_FOLDER if ideal else FOLDER
        self.folder, self._log = folder / name, folder / f"{name}.log"
        self.steps, self._ideal = list(steps), ideal
        self._child: Child | None = None

    @contextmanager
    def begun(self) -> Iterator[None]:
        """They run meanwhile; what has not ended after the block is ended."""
        if not self.steps:
            yield
            return
        shown = [scene.steps[-1].job for scene in scenes_of(self.steps)]
        words = ["--ideal"] * self._ideal + [word for job in shown for word in ("--job", job)]
        command = [str(console_script("cellward")), "demo", "--fast", "--out", str(self.folder), *words]
        with disk_errors(self.folder):
            (self.folder / ROWS_FILE).unlink(missing_ok=True)
        what = "all of it in ideal worlds" if self._ideal else ", ".join(shown)
        say(f"Beside it on virtual devices and a virtual clock: {what}; see {self._log}")
        nice = NICE_IDEAL if self._ideal else NICE
        with Child(f"demo on {self.folder.name}", command, self._log, nice) as self._child:
            yield

    def rows(self) -> list[Row]:
        """What became of each step, once they have ended; to be asked within :meth:`begun`."""
        if self._child is None:
            return []
        if not self._child.ended(0.0):
            say("waiting for the jobs on virtual devices")
            self._child.come_forward()
        if self._child.ended(LONGEST_S):
            try:
                rows = [Row(**row) for row in read_json(self.folder / ROWS_FILE)]
                return [replace(row, virtual=True) for row in rows]
            except CellError as exc:
                why = f"{exc}; {self._child.last_words()}"
        else:
            why = f"no end in {LONGEST_S:g} s"
        return [Row(s.job, "-", "-", f"not done: {why}", FAILED, s.twin, virtual=True) for s in self.steps]

    def cells(self) -> list[CellState]:
        """Their twins, for the index of the reports."""
        return [CellState(s.twin, self.folder / s.twin / STATE) for s in scenes_of(self.steps)]
