"""An encoder that counts by the clock; a real driver reads its device in ``_read``."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from cell.clock import Clock
from cell.devices import Encoder, EncoderState, Identity
from cell.samples import Sample, Stream
from drivers.life import Life


class AcmeEncoderConfig(BaseModel):
    """Keys of a device with ``driver = "acme-encoder"``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    counts_per_s: float = Field(default=0.0, description="how fast it counts")


class AcmeEncoder:
    """``cell.devices.Encoder`` of Acme."""

    Config = AcmeEncoderConfig
    PLAYS = (Encoder,)
    modulus, period_s = 2**16, 0.01

    def __init__(self, name: str, config: AcmeEncoderConfig, clock: Clock) -> None:
        self.name, self.config, self._clock = name, config, clock
        self._life = Life(name, clock)
        self.counts: Stream[EncoderState] = Stream(f"{name}.counts", clock)

    async def open(self) -> None:
        self._life.begin()
        self._life.keep_going(self._read(), "read")

    async def close(self) -> None:
        await self._life.end()

    async def identify(self) -> Identity:
        self._life.require()
        return Identity("Acme encoder", "9999A1")  # 9999 ...: it is simulated, so only for twins

    async def wait_fresh(self, timeout: float) -> None:
        await self._life.wait_fresh(self.counts, timeout)

    async def wait_lost(self) -> Exception:
        return await self._life.wait_lost()

    def health(self) -> dict[str, Any]:
        return {"counts": self.counts.received}

    async def _read(self) -> None:
        self.counts.new_epoch()
        now = began = self._clock.now()  # one reading: the first count is 0 on a slow PC too
        seq = 0
        while True:
            seq += 1
            count = int(self.config.counts_per_s * (now - began))
            self.counts.push(Sample(EncoderState(count, count % self.modulus), now, 0.0, seq))
            await self._clock.sleep(self.period_s)
            now = self._clock.now()
