"""Free space where the runs are written, against what the largest configured run writes."""

import asyncio
import logging
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.clock import Clock
from daemon.config import CellConfig
from daemon.job_config import make_procedure
from procedures.registry import JOBS

log = logging.getLogger("cellward.health")

# Of a colour picture and its depth as PNG: 180 frames of the twin's camera at 1280 x 800 are 350.3 MB.
PIXEL_BYTES = 1.9
LEAST_BYTES = 2 * 10**9  # the limit where no job writes pictures, or few
LOOK_S = 10.0


def free_bytes(folder: Path) -> int:
    """Free bytes on the disk of ``folder``, or of what exists of its path."""
    return shutil.disk_usage(next(p for p in (folder, *folder.parents) if p.is_dir())).free


def capture_bytes(config: CellConfig) -> int:
    """What the configured run with most pictures writes that takes each at the first attempt, by a recipe or
    not; 0 without any.

    All else that jobs write are some megabytes.
    """
    starts: list[tuple[str, Mapping[str, Any]]] = [(job, {}) for job in config.job]
    starts += [(recipe.job, recipe.parameters) for recipe in config.recipe.values()]
    jobs = (make_procedure(JOBS[job], config, {}, given) for job, given in starts if job in JOBS)
    return max((_bytes(config, *job.pictures()) for job in jobs), default=0)


def _bytes(config: CellConfig, role: str, pictures: int) -> int:
    camera = config.device.get(config.robot.roles().get(role, ""))
    pixels = getattr(camera, "width", 1280) * getattr(camera, "height", 800)
    return round(pictures * pixels * PIXEL_BYTES)


def low_limit(config: CellConfig) -> int:
    """Free bytes below which the disk is low: two captures, as attempts that fail write as well, or 2 GB."""
    return max(LEAST_BYTES, 2 * capture_bytes(config))


def low_text(folder: Path, free: int, limit: int) -> str:
    """What to do about a disk that is nearly full."""
    return (
        f"{folder}: {free / 1e9:.1f} GB are free, less than {limit / 1e9:.1f} GB; a full disk ends a run; "
        "'cellward prune' removes old runs"
    )


@dataclass
class DiskSpace:
    """Watches the disk of ``folder``, which is low with less than ``limit`` bytes free."""

    folder: Path
    clock: Clock
    limit: int = LEAST_BYTES
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
                    log.warning("%s", low_text(self.folder, self.free, self.limit))
                elif was_low and not self.low:
                    log.info("%s: space is free again", self.folder)
                was_low = self.low
            await self.clock.sleep(LOOK_S)

    @property
    def low(self) -> bool:
        return self.free is not None and self.free < self.limit

    def status(self) -> dict[str, Any]:
        """``free_bytes`` (None: unknown), ``limit_bytes``, and ``warning`` (None: there is room)."""
        warning = low_text(self.folder, self.free, self.limit) if self.low and self.free is not None else None
        return {"free_bytes": self.free, "limit_bytes": self.limit, "warning": warning}
