"""The steps of the demo that run on objects, in a process of their own beside those on real protocols."""

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

FOLDER, LOG = "objects", "objects.log"
NICE = 10  # twin and daemon come first, while there are any
LONGEST_S = 600.0


class ObjectSteps:
    """Those of ``steps`` that are objects, with their files in a folder of their own in ``folder``."""

    def __init__(self, folder: Path, steps: Sequence[Step]) -> None:
        self.folder, self._log = folder / FOLDER, folder / LOG
        self.steps = [step for step in steps if step.objects]
        self._child: Child | None = None

    @contextmanager
    def begun(self) -> Iterator[None]:
        """They run meanwhile; what has not ended after the block is ended."""
        if not self.steps:
            yield
            return
        shown = [scene.steps[-1].job for scene in scenes_of(self.steps)]
        jobs = [word for job in shown for word in ("--job", job)]
        command = [str(console_script("cellward")), "demo", "--fast", "--out", str(self.folder), *jobs]
        with disk_errors(self.folder):
            (self.folder / ROWS_FILE).unlink(missing_ok=True)
        say(f"Beside it on virtual devices and a virtual clock: {', '.join(shown)}; see {self._log}")
        with Child("demo on objects", command, self._log, NICE) as self._child:
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
