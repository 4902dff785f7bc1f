"""The folder of a demo or a rehearsal: its twin is new, so an earlier state must not come along."""

from itertools import count
from pathlib import Path

from daemon.cli.output import say


def begin_in(folder: Path, state: str, what: str) -> None:
    """Make ``folder`` for a demo or a rehearsal, as ``what`` says.

    A ``state`` folder in it, which holds what another twin's truth led to, is renamed, and it is said where
    its reports are now.
    """
    folder.mkdir(parents=True, exist_ok=True)
    old = folder / state
    if old.exists():
        kept = next(p for n in count(1) if not (p := folder / f"{state}-{n}").exists())
        old.rename(kept)
        say(f"What an earlier {what} left in {old}, its reports too, is now in {kept}")
