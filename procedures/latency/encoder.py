"""A belt's encoder as a source: items show the camera how the belt starts and stops."""

import asyncio
from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar

from cell.calibrations import belt_scale, time_offset
from cell.devices import Encoder, EncoderState, Frame, Intrinsics
from cell.errors import error
from cell.poses import to_pose6
from cell.procedure import FinishRequested, Run
from cell.run_values import RunValues
from cell.samples import Sample
from cell.store.files import append_lines
from procedures.belt.camera_to_belt import CameraToBelt
from procedures.belt.count_origin import CountOrigin
from procedures.latency.config import LatencyCalibrationConfig
from procedures.latency.solver import BELT_SIGHTINGS
from procedures.latency.states import S

CAMERA = "fixed_camera"
COUNTS_FILE, SIGHTINGS_FILE = "counts.jsonl", "sightings.jsonl"
LOOK_S = 0.25
STILL_S = 0.2  # without a count: the belt stands


class DelayedEncoder:
    """A :class:`.DelayedDevice`: nothing is moved; whoever runs the belt starts and stops it."""

    role: ClassVar[str] = "belt"
    signal: ClassVar[str] = BELT_SIGHTINGS

    def __init__(self, config: LatencyCalibrationConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.encoder = run.device(self.role, Encoder)  # its own stamps
        self.camera = run.camera(CAMERA)  # those of the offset in effect
        self.camera_to_belt = _camera_to_belt(config, run.values)
        self.counts: list[list[float]] = []
        self.sightings: list[dict[str, Any]] = []
        self.changes = 0
        self._told: Intrinsics | None = None
        self._written = (0, 0)  # of counts and sightings
        self._moved_at = self._changed_at = run.clock.now()
        self._stands = True
        self._origin = CountOrigin(
            self.encoder, self._belt, lambda event, **what: run.note("decision", event=event, **what)
        )

    @staticmethod
    def uses() -> tuple[str, ...]:
        return ("belt", CAMERA)

    @staticmethod
    def refuse(config: LatencyCalibrationConfig, values: RunValues) -> None:
        """Without a calibrated camera, or one whose own delay is unknown."""
        _camera_to_belt(config, values)
        known = values.time_offset_s[CAMERA]
        if "sigma" not in known and not known["applied"]:
            raise error(
                "LATENCY_CAMERA_UNKNOWN", "there is neither a version in effect nor a configured value"
            )

    @property
    def device(self) -> str:
        return self.encoder.name

    def data(self) -> dict[str, Any]:
        """Counts by the encoder's own stamps, sightings by the camera's as corrected, and what is known."""
        return {
            "T_base_camera": to_pose6(self.camera_to_belt.T_base_camera).tolist(),
            "camera": None if self._told is None else self.camera_to_belt.camera(self._told),
            "configured": self._belt,
            "camera_calibration": time_offset(self.camera.name),
            "camera_version": self.run.values.versions.get(time_offset(self.camera.name)),
            "camera_sigma_s": self.run.values.time_offset_s[CAMERA].get("sigma", 0.0),
            "encoder": self.counts,
            "sightings": self.sightings,
        }

    @property
    def _belt(self) -> Mapping[str, Any] | None:
        belt: Mapping[str, Any] | None = self.run.values.configured.get(belt_scale(self.encoder.name))
        return belt

    def amount(self) -> str:
        seen = sum(len(look["points"]) for look in self.sightings)
        return f"{seen} sightings, {self.changes} starts and stops" if seen else ""

    async def plan(self) -> dict[str, Any]:
        """What is waited for; nothing moves."""
        config = self.config
        return {
            "poses": [],
            "note": f"the job moves nothing; start and stop the belt {config.changes} times in all, with "
            f"items in view of the camera, until there are {config.sightings} sightings",
        }

    async def check(self) -> None:
        """The camera looks for items, and pictures and counts come."""
        await self.run.take_step(
            "prepare the camera", partial(self.camera.set_items, self.camera_to_belt.spec())
        )

    async def take(self) -> None:
        """Until the belt has started and stopped often enough, or does not any more.

        ``ENCODER_JUMP`` or ``DEVICE_LOST`` where the counts do not go on from each other, finished or not.
        """
        run, config = self.run, self.config
        undo = [
            self.encoder.counts.subscribe(self._count),
            self.camera.frames.subscribe(self._frame),
        ]
        self._changed_at = run.clock.now()
        try:
            await run.enter(S.WATCH, f"{config.changes} starts and stops of the belt")
            while self._origin.changed is None and not self._enough():
                if run.wants_rest:
                    await run.enter(S.WATCH)
                elif run.clock.now() - self._changed_at > config.patience_s:
                    why = f"the belt neither started nor stopped for {config.patience_s:g} s"
                    run.note("decision", event="finished early", why=why)
                    break
                else:
                    await run.clock.sleep(LOOK_S)
                    await self._keep()
        except FinishRequested:
            pass  # what there is will do
        finally:
            for end in undo:
                end()
            await asyncio.shield(self.camera.set_items(None))
            await asyncio.to_thread(self._flush)
        if self._origin.changed is not None:  # also where a hold, or somebody who finishes, came after it
            raise self._origin.changed

    def _enough(self) -> bool:
        config = self.config
        seen = sum(len(look["points"]) for look in self.sightings)
        share = min(self.changes / config.changes, seen / config.sightings)
        self.run.progress(min(int(share * config.changes), config.changes), config.changes)
        return self.changes >= config.changes and seen >= config.sightings

    async def _keep(self) -> None:
        await asyncio.to_thread(self._flush)

    def _flush(self) -> None:
        """What is new goes to disk; blocks. The loop may append meanwhile."""
        done, ends = self._written, (len(self.counts), len(self.sightings))
        counts = [{"t": t, "count": count} for t, count in self.counts[done[0] : ends[0]]]
        append_lines(self.run.folder / COUNTS_FILE, counts)
        append_lines(self.run.folder / SIGHTINGS_FILE, self.sightings[done[1] : ends[1]])
        self._written = ends

    # -- what comes in

    def _count(self, sample: Sample[EncoderState]) -> None:
        self._origin.moved(sample)
        moved = bool(self.counts) and sample.value.count != self.counts[-1][1]
        if moved:
            self._moved_at = sample.t
        stands = sample.t - self._moved_at > STILL_S
        if stands != self._stands and self.counts:
            self.changes += 1
            self._changed_at = self.run.clock.now()
        self._stands = stands
        self.counts.append([round(sample.t, 7), sample.value.count])

    def _frame(self, sample: Sample[Frame]) -> None:
        frame = sample.value
        if frame.items:
            self._told = self._told or frame.intrinsics
            self.sightings.append(
                {
                    "t": round(frame.t_exposure, 7),
                    "after_s": [round(frame.t_of(item.point) - frame.t_exposure, 7) for item in frame.items],
                    "points": [[round(float(v), 6) for v in item.point] for item in frame.items],
                }
            )


def _camera_to_belt(config: LatencyCalibrationConfig, values: RunValues) -> CameraToBelt:
    return CameraToBelt(values, config.belt_z_m or 0.0, config.items)
