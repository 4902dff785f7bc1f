"""Free space where the runs are written, against what the largest run writes."""

import asyncio
import logging
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.clock import Clock

log = logging.getLogger("cellward.health")

CAPTURE_BYTES = 365e6  # of one hand-eye capture of 200 frames with depth, the largest run there is
LOW_FREE_BYTES = 2 * 10**9  # five of them
LOOK_S = 10.0


def free_bytes(folder: Path) -> int:
    """Free bytes on the disk of ``folder``, or of what exists of its path."""
    return shutil.disk_usage(next(p for p in (folder, *folder.parents) if p.is_dir())).free


def low_text(folder: Path, free: int) -> str:
    """What to do about a disk that is nearly full."""
    return (
        f"{folder}: {free / 1e9:.1f} GB are free, less than {LOW_FREE_BYTES / 1e9:g} GB; a hand-eye "
        f"capture with depth takes up to {CAPTURE_BYTES / 1e6:.0f} MB and a full disk ends a run; "
        "'cellward prune' removes old runs"
    )


@dataclass
class DiskSpace:
    """Watches the disk of ``folder``."""

    folder: Path
    clock: Clock
    free: int | None = None  # None: not looked at yet, or the disk does not answer

    async def watch(self) -> None:
        """Look for ever, away from the loop; a disk that runs low is one log line, and so is its recovery."""
        was_low = False
        while True:
            try:
                self.free = await asyncio.to_thread(free_bytes, self.folder)
            except OSError as exc:
                self.free = None
                log.error("%s: %s", self.folder, exc.strerror or exc)
            else:
                if self.low and not was_low:
                    log.warning("%s", low_text(self.folder, self.free))
                elif was_low and not self.low:
                    log.info("%s: space is free again", self.folder)
                was_low = self.low
            await self.clock.sleep(LOOK_S)

    @property
    def low(self) -> bool:
        return self.free is not None and self.free < LOW_FREE_BYTES

    def status(self) -> dict[str, Any]:
        """``free_bytes`` (None: unknown), ``limit_bytes``, and ``warning`` (None: there is room)."""
        warning = low_text(self.folder, self.free) if self.low and self.free is not None else None
        return {"free_bytes": self.free, "limit_bytes": LOW_FREE_BYTES, "warning": warning}
