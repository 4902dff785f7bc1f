"""A gripper on virtual time that nothing confirms: it counts as closed after a time, as the drivers' does."""

from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from fakes.object import ObjectGripper, VirtualClock, run_virtual
from tests.kit.one_item import NO_ITEM

Scene = Callable[[ObjectGripper, VirtualClock], Coroutine[Any, Any, None]]


def play(folder: Path, scene: Scene, **config: Any) -> None:
    path = folder / "scenario.toml"
    path.write_text(NO_ITEM, "utf-8")

    async def whole() -> None:
        clock = VirtualClock()
        subject = ObjectGripper("gripper", ObjectGripper.Config(scenario=str(path), **config), clock)
        await subject.open()
        await clock.sleep(0.1)
        await scene(subject, clock)
        await subject.close()

    run_virtual(whole())


def test_without_a_confirmation_it_counts_as_closed_after_its_time_though_nothing_is_held(
    tmp_path: Path,
) -> None:
    async def scene(subject: ObjectGripper, clock: VirtualClock) -> None:
        begun = clock.now()
        assert await subject.grip(1.0)
        assert clock.now() - begun == pytest.approx(0.5, abs=0.01)
        assert subject.holding(1.0)
        assert await subject.release(1.0)
        assert not subject.holding(1.0)

    play(tmp_path, scene, counts_after_s=0.5)


def test_a_gripper_that_confirms_says_that_nothing_is_held(tmp_path: Path) -> None:
    async def scene(subject: ObjectGripper, clock: VirtualClock) -> None:
        assert not await subject.grip(1.0)
        assert not subject.holding(1.0)

    play(tmp_path, scene)


def test_a_time_beyond_the_timeout_is_refused_as_by_the_drivers(tmp_path: Path) -> None:
    async def scene(subject: ObjectGripper, clock: VirtualClock) -> None:
        with pytest.raises(CellError) as refused:
            await subject.grip(0.4)
        assert refused.value.name == "ARGUMENT_INVALID"
        assert "moves_s is 0.5 s, and the timeout is 0.4 s" in refused.value.detail

    play(tmp_path, scene, counts_after_s=0.5)
