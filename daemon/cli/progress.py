"""A progress bar on stderr for long work."""

import sys
from typing import Any, Self


class ProgressBar:
    """Shows itself only when stderr is a terminal; ``with ProgressBar() as bar: bar.show(...)``."""

    def __init__(self) -> None:
        self._progress: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
            )
            self._progress = Progress(*columns, console=Console(stderr=True))
            self._task = self._progress.add_task("starting", total=None)
            self._progress.start()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    @property
    def visible(self) -> bool:
        return self._progress is not None

    def show(self, what: str, done: int, total: int) -> None:
        """``done`` of ``total`` steps; a total of 0 is not known yet."""
        if self._progress is not None:
            self._progress.update(self._task, description=what, completed=done, total=total or None)
