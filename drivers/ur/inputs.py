"""The arm's own digital inputs: they share packet, and so stamp, with the joints."""

import asyncio
from typing import Any

from pydantic import Field, model_validator

from cell.clock import Clock
from cell.devices import ArmState, DigitalInputs, InputsState
from cell.errors import error
from cell.formats.reading import Strict
from cell.samples import Quality, Sample, Stream
from drivers.digital import InputConfig, StuckWatch
from drivers.ur.arm_part import ArmPart

# 0-7 standard, 8-15 configurable, 16-17 in the tool's connector
DIGITAL_INPUTS = 18


class ArmInputsConfig(Strict):
    """Keys of a device with ``driver = "arm-inputs"``."""

    arm: str = Field(default="arm", description="The device whose inputs these are")
    inputs: dict[str, InputConfig] = Field(
        min_length=1, description="By name; address 0-7 standard, 8-15 configurable, 16-17 in the tool"
    )
    connect_timeout_s: float = Field(default=3.0, gt=0.0, le=15.0, description="Wait for the arm's state")

    @model_validator(mode="after")
    def _are_inputs_of_an_arm(self) -> "ArmInputsConfig":
        for name, config in self.inputs.items():
            if config.address >= DIGITAL_INPUTS:
                raise ValueError(
                    f"input {name} has address {config.address},"
                    f" but a UR controller has inputs 0 to {DIGITAL_INPUTS - 1}"
                )
        return self


class ArmInputs(ArmPart):
    """``cell.devices.DigitalInputs`` of an arm that another section of the config names.

    It has no link of its own. What changed and changed back between two packages is not seen, as the
    controller tells levels only.
    """

    Config = ArmInputsConfig
    PLAYS = (DigitalInputs,)

    def __init__(self, name: str, config: ArmInputsConfig, clock: Clock) -> None:
        self.names = tuple(config.inputs)
        self.inputs: Stream[InputsState] = Stream(name, clock)
        super().__init__(name, clock)
        self._config = config
        self._places = tuple((1 << c.address, c.invert) for c in config.inputs.values())
        self._stuck = StuckWatch(name, config.inputs)
        self._undo: Any = None

    async def open(self) -> None:
        """Wait for the arm's next state; ``DEVICE_UNREACHABLE`` when there is none."""
        await self.close()
        self._life.begin()
        self.inputs.new_epoch()
        first: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        def take(sample: Sample[ArmState]) -> None:
            self._take(sample)
            if not first.done():
                first.set_result(None)

        self._undo = self._arm.state.subscribe(take)
        try:
            async with asyncio.timeout(self._config.connect_timeout_s):
                await first
            self._watch_arm()
            self._identity = await self._arm.identify()
        except TimeoutError:
            await self.close()
            raise error(
                "DEVICE_UNREACHABLE",
                f"{self.name}: {self._arm.name} gave no state in {self._config.connect_timeout_s:g} s",
            ) from None
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Listen to the arm no more; the arm itself stays as it is."""
        undo, self._undo = self._undo, None
        if undo is not None:
            undo()
        await self._stop_watching()
        self._life.lose(error("DEVICE_LOST", f"{self.name} was closed"))

    def health(self) -> dict[str, Any]:
        """Samples and gaps; age (s) of the newest; levels; how long (s) what is stuck has not changed."""
        last, now = self.inputs.last(), self._clock.now()
        return {
            "connected": self._life.good,
            "age_s": None if last is None else now - last.t,
            "samples": self.inputs.received,
            "gaps": self.inputs.gaps,
            "epoch": self.inputs.epoch,
            "levels": {} if last is None else dict(zip(self.names, last.value.levels, strict=True)),
            "stuck_s": self._stuck.report(now),
        }

    def _take(self, sample: Sample[ArmState]) -> None:
        if not self._life.good:
            return
        last, word = self.inputs.last(), sample.value.digital_in
        levels = tuple(bool(word & bit) != invert for bit, invert in self._places)
        if last is None:
            changes = (0,) * len(levels)
            self._stuck.begin(sample.t, changes)
        elif sample.seq <= last.seq:
            self._life.lose(error("DEVICE_LOST", f"{self.name}: {self._arm.name} was connected anew"))
            return
        else:
            before = last.value
            changes = tuple(
                n + (a != b) for n, a, b in zip(before.changes, before.levels, levels, strict=True)
            )
        stuck = self._stuck.take(sample.t, levels, changes)
        quality = Quality.DEGRADED if stuck else sample.quality
        self.inputs.push(Sample(InputsState(levels, changes), sample.t, sample.dt, sample.seq, quality))
