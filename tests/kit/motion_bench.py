"""An arm that stops only on the steps it is told to, and a lease on it."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.devices import ArmState, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError, error
from cell.interruptions import Interruptions
from cell.motion import MotionBroker, MotionLease
from cell.samples import Sample, Stream
from fakes.object.clock import VirtualClock

SPEED = Speed(0.25, 0.5, 0.8, 2.0)
TOOL = ToolSettings(RigidTransform.identity(), 1.0)
TARGET = np.ones(6)


@dataclass
class ScriptedArm:
    """Moves at a constant speed until one of the steps in ``obeys`` reaches it."""

    obeys: set[str] = field(default_factory=lambda: {"decelerate"})
    name: str = "arm"
    silent: bool = False
    program_running: bool = True
    refusal: CellError | None = None
    hang: set[str] = field(default_factory=set)
    motion_begun: bool = True
    time_offset_s: float = 0.0
    usable: bool = True
    ended_unseen: bool = False

    def __post_init__(self) -> None:
        self.clock = VirtualClock()
        self.state: Stream[ArmState] = Stream("arm", self.clock)
        self.moving = False
        self.q, self._seq = np.zeros(6), 0
        self.asked: list[str] = []

    async def sample_for_ever(self) -> None:
        while True:
            if not self.silent:
                self.sample()
            await asyncio.sleep(0.01)

    def sample(self) -> None:
        qd = np.full(6, 0.3 if self.moving else 0.0)
        zero = np.zeros(6)
        state = ArmState(self.q, qd, zero, zero, zero, 7, 1, self.program_running, 0, 0, 0.0)
        self.state.push(Sample(state, self.clock.now() + self.time_offset_s, 0.001, self._seq))
        self._seq += 1

    def check_movable(self) -> None:
        if self.refusal is not None:
            raise self.refusal

    async def open_motion(self, tool: ToolSettings) -> "ScriptedArm":
        await self._step("open")
        return self

    async def move_joints(self, q: Any, speed: Speed) -> None:
        self.moving = True
        await asyncio.sleep(3600.0)

    async def stream(self, pieces: AsyncIterator[TrajectoryPiece]) -> None:
        async for _ in pieces:
            self.moving = True
            await asyncio.sleep(3600.0)

    async def decelerate(self) -> None:
        await self._step("decelerate")

    async def stop_script(self) -> None:
        await self._step("stop_script")

    async def stop_program(self) -> None:
        await self._step("stop_program")

    async def close(self) -> None:
        await self._step("close")

    async def _step(self, name: str) -> None:
        self.asked.append(name)
        if name in self.hang:
            await asyncio.sleep(3600.0)
        if name in self.obeys:
            self.moving = False


async def no_wait() -> None: ...


class OpenGuard:
    def check_path_joints(self, q0: Any, q1: Any) -> None: ...
    def check_path_linear(self, T0: Any, T1: Any, q0: Any, speed_m_s: Any = None) -> None: ...
    def check_setpoints(self, Q: Any, Qd: Any) -> None: ...


@dataclass
class Notes:
    lines: list[dict[str, Any]] = field(default_factory=list)
    disk_full: bool = False

    def note(self, kind: str, **fields: Any) -> None:
        if self.disk_full:
            raise error("DISK_FULL", "journal.jsonl")
        self.lines.append({"kind": kind, **fields})

    def standstill_after(self) -> list[str]:
        return [n["after"] for n in self.lines if n.get("event") == "standstill"]


@dataclass
class Bench:
    arm: ScriptedArm
    broker: MotionBroker
    notes: Notes

    def lease(self, steps: Interruptions | None = None, guard: Any = None) -> MotionLease:
        guard = guard or OpenGuard()
        return self.broker.lease(self.arm, guard, TOOL, SPEED, self.notes, None, steps)  # type: ignore[arg-type]

    async def drive(self) -> None:
        async with self.lease() as lease:
            await lease.move_joints(TARGET)


@asynccontextmanager
async def bench_with(arm: ScriptedArm) -> AsyncIterator[Bench]:
    feed = asyncio.create_task(arm.sample_for_ever())
    await asyncio.sleep(0.05)
    try:
        yield Bench(arm, MotionBroker(arm.clock), Notes())
    finally:
        feed.cancel()
        await asyncio.wait([feed])
