"""The demo's folder: its twin is new each time, so the state of an earlier demo must not come along."""

from itertools import count
from pathlib import Path

from daemon.cli.output import say


def begin_in(folder: Path, state: str) -> None:
    """Make ``folder``; a ``state`` folder in it, which holds what another twin's truth led to, is renamed."""
    folder.mkdir(parents=True, exist_ok=True)
    old = folder / state
    if old.exists():
        kept = next(p for n in count(1) if not (p := folder / f"{state}-{n}").exists())
        old.rename(kept)
        say(f"What an earlier demo left is now in {kept}")
