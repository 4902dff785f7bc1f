"""What every device promises, whatever it measures."""

import asyncio
from typing import Any, Generic, TypeVar

import pytest

from cell.errors import CellError
from cell.testing.bench import Bench, Rig, known

R = TypeVar("R", bound=Rig[Any])
FRESH_S = 10.0


class DeviceContract(Generic[R]):
    """It says who it is, tells the end of its link, and can be opened again."""

    def test_a_device_says_who_it_is_and_keeps_its_identity(self, subject: Bench[R]) -> None:
        async def scene(rig: R) -> None:
            found = await rig.device.identify()
            assert found.model
            assert found.serial
            assert await rig.device.identify() == found

        subject(scene)

    def test_a_twin_says_that_it_is_one(self, subject: Bench[R]) -> None:
        subject.needs("truth")

        async def scene(rig: R) -> None:
            found, expected = await rig.device.identify(), known(rig.identity, "identity")
            assert found.is_twin
            assert found.serial == expected.serial
            assert expected.model in ("", found.model)

        subject(scene)

    def test_a_closed_device_says_so_and_closing_again_is_harmless(self, subject: Bench[R]) -> None:
        async def scene(rig: R) -> None:
            await rig.device.close()
            await rig.device.close()
            async with asyncio.timeout(FRESH_S):
                found = await rig.device.wait_lost()
            assert isinstance(found, CellError)
            assert found.name == "DEVICE_LOST"
            for refused in (rig.device.identify(), rig.device.wait_fresh(0.1)):
                with pytest.raises(CellError) as caught:
                    await refused
                assert caught.value.name == "DEVICE_LOST"
            assert isinstance(rig.device.health(), dict)

        subject(scene)

    def test_a_device_that_was_closed_opens_again_and_gives_fresh_samples(self, subject: Bench[R]) -> None:
        async def scene(rig: R) -> None:
            identity = await rig.device.identify()
            await rig.device.close()
            await rig.device.open()
            await rig.device.wait_fresh(FRESH_S)
            assert await rig.device.identify() == identity

        subject(scene)
