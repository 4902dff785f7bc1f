"""A camera and an encoder whose stamps are late by more than their driver takes off.

A delay that was measured takes effect at the next run, not at the next start of the driver. Whoever works
with a device through these classes sees every stamp earlier by ``late_s``: what the offset in effect is above
the one that the driver has subtracted already. How old a sample is stays with the stamp of the device.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cell.devices import DepthCamera, Encoder, EncoderState, Frame, Identity
from cell.samples import Mapped, Readings


class _Passed:
    """What a device does whatever its stamps are."""

    def __init__(self, device: DepthCamera | Encoder) -> None:
        self.name, self._device = device.name, device

    async def open(self) -> None:
        await self._device.open()

    async def close(self) -> None:
        await self._device.close()

    async def identify(self) -> Identity:
        return await self._device.identify()

    async def wait_fresh(self, timeout: float) -> None:
        await self._device.wait_fresh(timeout)

    async def wait_lost(self) -> Exception:
        return await self._device.wait_lost()

    def health(self) -> dict[str, Any]:
        return self._device.health()


class CorrectedCamera(_Passed):
    """``camera`` with stamps earlier by ``late_s``. Implements :class:`cell.devices.DepthCamera`."""

    def __init__(self, camera: DepthCamera, late_s: float) -> None:
        super().__init__(camera)
        self._camera, self._late_s = camera, late_s
        self._frames = Mapped(camera.frames, self._see, late_s)

    @property
    def frames(self) -> Readings[Frame]:
        return self._frames

    async def set_target(self, target: dict[str, Any] | None) -> None:
        await self._camera.set_target(target)

    async def set_items(self, spec: dict[str, Any] | None) -> None:
        await self._camera.set_items(spec)

    async def capture(self, count: int, folder: Path, stem: str, after: float) -> Sequence[Frame]:
        taken = await self._camera.capture(count, folder, stem, after + self._late_s)
        return [self._see(frame) for frame in taken]

    def _see(self, frame: Frame) -> Frame:
        return replace(frame, t_exposure=frame.t_exposure - self._late_s)


class CorrectedEncoder(_Passed):
    """``encoder`` with stamps earlier by ``late_s``. Implements :class:`cell.devices.Encoder`."""

    def __init__(self, encoder: Encoder, late_s: float) -> None:
        super().__init__(encoder)
        self.modulus, self.period_s = encoder.modulus, encoder.period_s
        self._counts = Mapped(encoder.counts, lambda state: state, late_s)

    @property
    def counts(self) -> Readings[EncoderState]:
        return self._counts
