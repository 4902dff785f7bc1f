"""A gripper on outputs of the arm, written by an input recipe of our own RTDE link."""

import asyncio
from collections.abc import Sequence
from typing import Any, Self

from pydantic import Field, model_validator

from cell.clock import Clock
from cell.devices import ArmState, Gripper
from cell.errors import CellError, error
from cell.formats.reading import Strict
from cell.samples import GAP_S, Sample
from drivers.ur.arm_part import ArmPart
from drivers.ur.gripper_outputs import GripperOutputs
from drivers.ur.inputs import DIGITAL_INPUTS
from drivers.ur.rtde import Recipe
from drivers.ur.rtde_link import RtdeLink
from drivers.valve import check_valve

_READ_BACK_S = 0.1
_SILENT_S = 0.2  # without a state of the arm


class ArmGripperConfig(Strict):
    """Keys of a device with ``driver = "arm-gripper"``."""

    arm: str = Field(default="arm", description="The device whose outputs and inputs these are")
    output: int = Field(
        ge=0, lt=DIGITAL_INPUTS, description="0-7 standard, 8-15 configurable, 16-17 in the tool; on closes"
    )
    invert_output: bool = Field(default=False, description="Off closes")
    open_output: int | None = Field(
        default=None,
        ge=0,
        lt=DIGITAL_INPUTS,
        description="Another output, on opens: of a valve with two coils, or the one that blows off a vacuum",
    )
    blow_off_s: float | None = Field(
        default=None, gt=0, le=5, description="open_output is on for so long; absent: until it closes again"
    )
    confirm: int | None = Field(
        default=None,
        ge=0,
        lt=DIGITAL_INPUTS,
        description="Input that is on while something is held, as of a vacuum switch; absent: unknown",
    )
    invert_confirm: bool = Field(default=False, description="true: the input is off while something is held")
    moves_s: float | None = Field(
        default=None,
        gt=0,
        le=5,
        description="Without confirm: it counts as closed, or open, after so long, whether it holds or not",
    )
    connect_timeout_s: float = Field(
        default=3.0, gt=0.0, le=15.0, description="longest wait for a connection, s"
    )

    @model_validator(mode="after")
    def _checked(self) -> Self:
        check_valve(self)
        return self


class ArmGripper(ArmPart):
    """``cell.devices.Gripper``. It changes its output in :meth:`grip` and :meth:`release` only, so neither
    opening nor losing the link lets a held part fall; an output keeps its level when nobody writes it."""

    Config = ArmGripperConfig
    PLAYS = (Gripper,)

    def __init__(self, name: str, config: ArmGripperConfig, clock: Clock) -> None:
        super().__init__(name, clock)
        self._config = config
        self._link: RtdeLink | None = None
        self._recipe: Recipe | None = None
        self._outputs = GripperOutputs(config.output, config.open_output, config.invert_output)

    async def open(self) -> None:
        """Claim the output; ``ARM_REGISTER_CONFLICT`` when another RTDE client has it."""
        await self.close()
        host = getattr(self._arm, "host", None)
        if host is None:
            raise error(
                "CONFIG_INVALID", f"{self.name}: {self._arm.name} has no RTDE; its driver should be 'ur'"
            )
        self._life.begin()
        try:
            self._identity = await self._arm.identify()
            timeout = self._config.connect_timeout_s
            self._link = await RtdeLink.connect(host, self._clock, self._lose, timeout)
            names = self._outputs.variables
            recipe = await self._link.setup_inputs(names, timeout)
            if recipe.id == 0:
                raise error(
                    "ARM_REGISTER_CONFLICT", f"{self.name}: {', '.join(names)}: {', '.join(recipe.types)}"
                )
            self._recipe = recipe
            self._watch_arm()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Give the output back as it is."""
        await self._stop_watching()
        link, self._link, self._recipe = self._link, None, None
        if link is not None:
            link.close()
        self._life.lose(error("DEVICE_LOST", f"{self.name} was closed"))

    def health(self) -> dict[str, Any]:
        """Whether the fingers are told to close, and whether something is held; None while unknown."""
        last = self._arm.state.last() if self._life.good else None
        return {
            "connected": self._life.good,
            "closed": None if last is None else self._outputs.is_closed(last.value.digital_out),
            "holding": None if last is None else self._is_held(last.value),
        }

    @property
    def confirms(self) -> bool:
        """Whether an input tells that something is held."""
        return self._config.confirm is not None

    async def grip(self, timeout: float) -> bool:
        """Close; True when the confirm input came within ``timeout`` s, or after ``moves_s`` without one."""
        await self._write(self._outputs.levels(close=True, opening=False))
        return await self._answers(True, timeout)

    async def release(self, timeout: float) -> bool:
        """Open; True when the confirm input went within ``timeout`` s, or after ``moves_s`` without one."""
        begun = self._clock.now()
        await self._write(self._outputs.levels(close=False, opening=True))
        opened = await self._answers(False, timeout)
        if self._config.blow_off_s is not None:
            await self._clock.sleep(max(begun + self._config.blow_off_s - self._clock.now(), 0.0))
            await self._write(self._outputs.levels(close=False, opening=False))
        return opened

    def holding(self, max_age: float) -> bool:
        """Whether something is held, from a state at most ``max_age`` s old; else ``STALE_DATA``."""
        self._life.require()
        return self._is_held(self._arm.state.latest(max_age).value)

    async def _write(self, levels: Sequence[tuple[int, bool]]) -> None:
        """Set the outputs and see them set; ``CALL_TIMEOUT`` when the arm's own state does not show it."""
        link, recipe = self._opened(self._link), self._opened(self._recipe)
        for package in self._outputs.packages(levels):
            await link.send(recipe.pack(package))
        if not await self._becomes(lambda s: self._outputs.are(s.digital_out, levels), True, _READ_BACK_S):
            outputs = " and ".join(str(output) for output, _ in levels)
            raise error("CALL_TIMEOUT", f"{self.name}: output {outputs} did not follow in {_READ_BACK_S:g} s")

    async def _answers(self, held: bool, timeout: float) -> bool:
        """Whether it has closed, or opened, within ``timeout``."""
        if self._config.confirm is not None or self._config.moves_s is None:
            return await self._becomes(self._is_held, held, timeout)
        if self._config.moves_s > timeout:
            raise error(
                "ARGUMENT_INVALID",
                f"{self.name}: moves_s is {self._config.moves_s:g} s, and the timeout is {timeout:g} s",
            )
        await self._clock.sleep(self._config.moves_s)
        self._life.require()
        return True

    async def _becomes(self, what: Any, wanted: bool, timeout: float) -> bool:
        """Whether ``what`` of the arm's states is ``wanted`` within ``timeout`` s of states that came.

        A lost link raises, and ``STALE_DATA`` while the arm is silent: that is no answer of the gripper's.
        """
        done: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        began = before = self._clock.now()

        def look(sample: Sample[ArmState]) -> None:
            nonlocal began, before
            if done.done():
                return
            if sample.t - before > GAP_S:
                began = sample.t  # what was asked for may have come as late as the states
            before = max(before, sample.t)
            if what(sample.value) is wanted:
                done.set_result(True)
            elif sample.t - began > timeout:
                done.set_result(False)

        lost: asyncio.Future[Any] = asyncio.ensure_future(self._life.wait_lost())
        undo = self._arm.state.subscribe(look)
        try:
            either: list[asyncio.Future[Any]] = [done, lost]
            while not done.done():
                await asyncio.wait(either, timeout=_SILENT_S, return_when=asyncio.FIRST_COMPLETED)
                self._life.require()
                self._arm.state.latest(_SILENT_S)
        finally:
            undo()
            lost.cancel()
        return done.result()

    def _is_held(self, state: ArmState) -> bool:
        if self._config.confirm is None:
            return self._outputs.is_closed(state.digital_out)
        return bool(state.digital_in >> self._config.confirm & 1) is not self._config.invert_confirm

    def _lose(self, failure: CellError) -> None:
        self._life.lose(failure)
