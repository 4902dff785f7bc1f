"""The module behind every wire: inputs as functions of time, counters to clear and to stop, and who it is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from cell.errors import error

COUNTER_MODULUS = 1 << 32


Action = Callable[[], None]


class UnitTables(Protocol):
    """What a wire asks: four tables as they are at this instant, and what a write would do.

    ``coil`` and ``register`` raise :class:`~fakes.modbus_io.pdu.Refused` before anything has happened.
    """

    @property
    def identity(self) -> "Identity": ...
    def coils(self) -> Mapping[int, bool]: ...
    def discrete(self) -> Mapping[int, bool]: ...
    def holding(self) -> Mapping[int, int]: ...
    def input(self) -> Mapping[int, int]: ...
    def coil(self, address: int, on: bool) -> Action: ...
    def register(self, address: int, value: int) -> Action: ...
    def restart(self, serial: str | None = None) -> None:
        """Begin as after power was lost; with ``serial`` another device is in its place."""
        ...


class Inputs(Protocol):
    """The physics: what each input sees at cell time ``t`` (s), asked with times that never run back."""

    def levels(self, t: float) -> tuple[bool, ...]: ...
    def counts(self, t: float) -> tuple[int, ...]:
        """Rising edges counted per input, modulo 2^32; none at all when the module has no counters."""
        ...

    def reboot(self, t: float) -> None:
        """Count from 0 again."""
        ...


@dataclass(frozen=True)
class Identity:
    """What function 43/14 tells. Twin serials begin with 9999."""

    product: str
    serial: str = "99993300001"
    vendor: str = "Cellward twin"
    revision: str = "1.0"

    def objects(self) -> dict[int, str]:
        """Text by object id; the serial lies in the private range."""
        return {0x00: self.vendor, 0x01: self.product, 0x02: self.revision, 0x80: self.serial}


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All of the module at one instant, padded to its number of channels; ``counts`` of a module without
    counters stay 0."""

    levels: tuple[bool, ...]
    counts: tuple[int, ...]
    has_counters: bool
    counting: tuple[bool, ...]
    overflown: tuple[bool, ...]
    outputs: tuple[bool, ...]


class RegisterMap(Protocol):
    """Where one make of module keeps what: a table per function, and what a write does.

    ``coil`` and ``register`` return the action, or raise :class:`~fakes.modbus_io.pdu.Refused` before
    anything has happened.
    """

    @property
    def channels(self) -> int: ...
    @property
    def outputs(self) -> int: ...

    def coils(self, now: Snapshot) -> Mapping[int, bool]: ...
    def discrete(self, now: Snapshot) -> Mapping[int, bool]: ...
    def holding(self, now: Snapshot) -> Mapping[int, int]: ...
    def input(self, now: Snapshot) -> Mapping[int, int]: ...
    def coil(self, module: "Module", address: int, on: bool) -> Action: ...
    def register(self, module: "Module", address: int, value: int) -> Action: ...


@dataclass
class _Counter:
    """What a channel adds to the physics: an offset that a clear moves, and a value held while stopped."""

    base: int = 0
    held: int | None = None
    last: int = 0
    overflown: bool = False

    def read(self, raw: int) -> int:
        value = (raw - self.base) % COUNTER_MODULUS if self.held is None else self.held
        self.overflown |= value < self.last
        self.last = value
        return value

    def set(self, raw: int, value: int) -> None:
        self.base, self.last = raw - value, value
        if self.held is not None:
            self.held = value

    def run(self, raw: int, on: bool) -> None:
        value = self.read(raw)
        self.base, self.held = raw - value, None if on else value


class Module:
    """One module: ``inputs`` seen through ``registers``, at the instants that ``now`` gives."""

    def __init__(
        self, inputs: Inputs, registers: RegisterMap, identity: Identity, now: Callable[[], float]
    ) -> None:
        self._inputs, self._now = inputs, now
        self.registers, self.identity = registers, identity
        wired = len(inputs.levels(now()))
        self.has_counters = len(inputs.counts(now())) > 0
        if wired > registers.channels:
            raise error(
                "ARGUMENT_INVALID", f"{identity.product} has {registers.channels} inputs, {wired} are wired"
            )
        self._counters = [_Counter() for _ in range(registers.channels)]
        self._outputs = [False] * registers.outputs

    def snapshot(self) -> Snapshot:
        """Everything at this instant."""
        t = self._now()
        unused = self.registers.channels - len(levels := tuple(self._inputs.levels(t)))
        raw = self._raw(t)
        return Snapshot(
            (*levels, *(False,) * unused),
            tuple(counter.read(count) for counter, count in zip(self._counters, raw, strict=True)),
            self.has_counters,
            tuple(counter.held is None for counter in self._counters),
            tuple(counter.overflown for counter in self._counters),
            tuple(self._outputs),
        )

    def coils(self) -> Mapping[int, bool]:
        return self.registers.coils(self.snapshot())

    def discrete(self) -> Mapping[int, bool]:
        return self.registers.discrete(self.snapshot())

    def holding(self) -> Mapping[int, int]:
        return self.registers.holding(self.snapshot())

    def input(self) -> Mapping[int, int]:
        return self.registers.input(self.snapshot())

    def coil(self, address: int, on: bool) -> Action:
        return self.registers.coil(self, address, on)

    def register(self, address: int, value: int) -> Action:
        return self.registers.register(self, address, value)

    def set_count(self, channel: int, value: int) -> None:
        """Let the counter go on from ``value``; 0 clears it."""
        self._counters[channel].set(self._raw(self._now())[channel], value)

    def count(self, channel: int) -> int:
        """The counter's value now."""
        return self._counters[channel].read(self._raw(self._now())[channel])

    def run_counter(self, channel: int, on: bool) -> None:
        """Start the counter, or stop it at the value that it has."""
        self._counters[channel].run(self._raw(self._now())[channel], on)

    def clear_overflow(self, channel: int) -> None:
        self._counters[channel].overflown = False

    def set_output(self, channel: int, on: bool) -> None:
        """Switch an output; nothing is wired to it."""
        self._outputs[channel] = on

    def follow_inputs(self) -> None:
        """Show the counts of the inputs as they are, as if no counter had ever been cleared or stopped."""
        self._counters = [_Counter(last=count) for count in self._raw(self._now())]

    def restart(self, serial: str | None = None) -> None:
        """Counters run from 0 and outputs are off; with ``serial`` another module is in its place."""
        self._inputs.reboot(self._now())
        self.follow_inputs()
        self._outputs = [False] * self.registers.outputs
        if serial is not None:
            self.identity = replace(self.identity, serial=serial)

    def _raw(self, t: float) -> tuple[int, ...]:
        counts = tuple(self._inputs.counts(t))
        return (*counts, *(0,) * (self.registers.channels - len(counts)))
