"""A request of a pose that gets no answer: it may have been carried out, and costs a step, not the run."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.devices import Identity
from cell.errors import CellError, error
from cell.interruptions import Interruptions
from drivers.modbus.link import NoAnswer
from drivers.modbus.registers import Span
from drivers.observed_arm import ObservedArmConfig, ObservedArmReader, registers
from procedures.asked_arm import AskedArm

CLOCK = MonotonicClock()
THERE = np.array([0.5])
JOINT, REACHED, TARGET, NUMBER = 0, 10, 20, 28
NEVER_ANSWERS = -1
SECTION = {
    "url": "tcp://127.0.0.1:502",
    "joints": [{"address": JOINT, "type": "int16", "scale": 0.001}],
    "handshake": {"targets": [TARGET], "number": NUMBER, "reached": REACHED},
    "allow_requests": True,
    "poll_period_s": 0.01,
    "rest_window_s": 0.05,
}


class _Controller:
    """A Modbus link to a program that goes where it is asked to at once.

    The answers to the first ``lost`` writes of a number are lost, though the number was written.
    """

    def __init__(self, lost: int) -> None:
        self.lost, self.numbers = lost, list[int]()
        self._registers = dict.fromkeys((JOINT, REACHED, TARGET, NUMBER), 0)

    async def connect(self) -> None: ...

    async def close(self) -> None: ...

    async def read(self, span: Span) -> list[int]:
        return [self._registers[span.start + i] for i in range(span.count)]

    async def write(self, start: int, words: list[int]) -> None:
        (self._registers[start],) = words
        if start != NUMBER:
            return
        self.numbers += words
        if words == [0]:
            if self.lost == NEVER_ANSWERS:
                raise NoAnswer("no answer in 0.2 s")
            return
        self._registers[JOINT], self._registers[REACHED] = self._registers[TARGET], words[0]
        if self.lost:
            self.lost -= 1
            raise NoAnswer("no answer in 0.2 s")


class _Run:
    """What an asked arm needs of a run."""

    clock = CLOCK

    def __init__(self, arm: ObservedArmReader) -> None:
        self._arm, self.notes = arm, list[dict[str, Any]]()
        self.steps = Interruptions(CLOCK, lambda: arm.wait_fresh(2.0), self.note)
        self.take_step = self.steps.step

    def observed_arm(self) -> ObservedArmReader:
        return self._arm

    def note(self, kind: str, **fields: Any) -> None:
        self.notes.append({"kind": kind, **fields})


async def _identified(*_: object) -> Identity:
    return Identity("arm", "1")


async def _opened(controller: _Controller, monkeypatch: pytest.MonkeyPatch) -> ObservedArmReader:
    monkeypatch.setattr(registers, "ModbusLink", lambda *_: controller)
    monkeypatch.setattr(registers, "identify", _identified)
    arm = ObservedArmReader("arm", ObservedArmConfig.model_validate(SECTION), CLOCK)
    await arm.open()
    return arm


def _asked(run: _Run) -> AskedArm:
    live: Any = run
    return AskedArm(live, SimpleNamespace(request_timeout_s=10.0))


def test_an_unanswered_request_is_taken_again_under_a_number_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It was carried out; what the arm shows for it is no answer to the second one."""
    controller = _Controller(lost=1)

    async def main() -> _Run:
        arm = await _opened(controller, monkeypatch)
        run = _Run(arm)
        asked = _asked(run)
        try:
            async with asked.session():
                await run.take_step("target 1", lambda: asked.ask_for(THERE, "target 1"))
        finally:
            await arm.close()
        return run

    run = asyncio.run(main())
    assert controller.numbers == [0, 1, 0, 2, 0]
    (again,) = run.steps.taken_again
    assert (again["step"], again["cause"]) == ("target 1", "DEVICE_LOST")
    assert "request of pose 1: no answer in 0.2 s" in again["why"]


def test_a_request_that_cannot_be_taken_back_at_the_end_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = _Controller(lost=0)

    async def main() -> _Run:
        arm = await _opened(controller, monkeypatch)
        run = _Run(arm)
        asked = _asked(run)
        try:
            with pytest.raises(CellError, match="full"):
                async with asked.session():
                    await asked.ask_for(THERE, "target 1")
                    controller.lost = NEVER_ANSWERS
                    raise error("OBSERVED_ARM_NOT_THERE", "full")
        finally:
            await arm.close()
        return run

    run = asyncio.run(main())
    assert controller.numbers == [0, 1, 0]
    (told,) = run.notes
    assert (told["event"], told["name"]) == ("request not taken back", "DEVICE_LOST")
